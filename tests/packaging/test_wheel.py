"""The wheel holds everything that the program reads."""

import re
import tomllib
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("app", "ui", "gsrain_engine", "shaders", "sample_configs")


@pytest.fixture(scope="module")
def in_wheel():
    """Paths in the wheel, as its builder lists them."""
    builder = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is missing (extra dev)")
    return {file.distribution_path for file in builder.WheelBuilder(str(REPOSITORY)).recurse_included_files()}


def test_the_wheel_holds_every_file_of_every_package(in_wheel):
    files = (file for package in PACKAGES for file in (REPOSITORY / package).rglob("*") if file.is_file())
    wanted = {str(file.relative_to(REPOSITORY)) for file in files if "__pycache__" not in file.parts}
    assert {"shaders/splat.frag", "sample_configs/rain/8.5.yaml", "app/icons/16.png"} <= wanted
    assert wanted - in_wheel == set(), "left out of the wheel (by .gitignore?)"


def test_the_wheel_holds_nothing_else(in_wheel):
    assert {path.split("/")[0] for path in in_wheel} == set(PACKAGES)


def test_every_package_that_is_read_as_data_is_a_package():
    """importlib.resources finds folders without __init__.py too, but not in every way of installing."""
    assert [package for package in PACKAGES if not (REPOSITORY / package / "__init__.py").is_file()] == []


def test_the_newest_release_among_the_changes_is_this_version():
    version = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    newest = re.search(r"^## (?!Unreleased)(\S+)", (REPOSITORY / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert newest is not None
    assert newest[1] == version
