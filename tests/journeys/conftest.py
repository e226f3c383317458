"""The program as pip installs it: journeys begin there, away from the checkout."""

import os
import subprocess
import sys

import pytest

from repository import REPOSITORY


@pytest.fixture(scope="session")
def installed(tmp_path_factory):
    """Return the folder of an installed wheel, and an environment that finds it first."""
    builder = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is missing (extra dev)")
    folder = tmp_path_factory.mktemp("wheel")
    wheel = next(builder.WheelBuilder(str(REPOSITORY)).build(directory=str(folder), versions=["standard"]))
    site = folder / "site"
    # What it needs is there already; its modules are compiled as they are used.
    alone = "--no-deps", "--no-index", "--no-compile", "--quiet", "--disable-pip-version-check"
    subprocess.run([sys.executable, "-m", "pip", "install", *alone, "--target", site, wheel], check=True)
    return site, os.environ | {"PYTHONPATH": str(site)}
