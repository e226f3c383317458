"""The wheel holds everything that the program reads."""

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from gsrain_engine.editor.guide import FOLDER, guide_pages
from gsrain_engine.presets import shipped_config_names, shipped_path

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("app", "ui", "gsrain", "gsrain_engine", "gsrain_extras")
SHIPPED = ("shaders", "sample_configs")
"""Data, which a wheel has inside of the engine."""


@pytest.fixture(scope="module")
def in_wheel():
    """Paths in the wheel, as its builder lists them."""
    builder = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is missing (extra dev)")
    return {file.distribution_path for file in builder.WheelBuilder(str(REPOSITORY)).recurse_included_files()}


def test_the_wheel_holds_every_file_of_every_package_and_nothing_else(in_wheel):
    places = {package: package for package in PACKAGES} | {name: f"gsrain_engine/{name}" for name in SHIPPED}
    wanted = {
        f"{place}/{file.relative_to(REPOSITORY / folder)}"
        for folder, place in places.items()
        for file in (REPOSITORY / folder).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    assert {
        "gsrain_engine/shaders/splat.frag", "gsrain_engine/sample_configs/rain/8.5.yaml", "app/icons/16.png",
        "gsrain/__init__.pyi", "gsrain/py.typed",
    } <= wanted  # fmt: skip
    build = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["tool"]["hatch"]["build"]
    assert build["targets"]["wheel"]["force-include"] == {
        each: f"gsrain_engine/{each}"
        for each in ("CHANGELOG.md", "docs/guide", "docs/driving.md", "docs/physics/drops.md")
    }  # which What's new and the guide show
    assert {f"gsrain_engine/{FOLDER}/{page}" for page in guide_pages() if "/" not in page} <= in_wheel
    assert wanted - in_wheel == set(), "left out of the wheel (by .gitignore?)"
    assert {path.split("/")[0] for path in in_wheel} == set(PACKAGES)


def test_a_wheel_may_bring_kernels_and_is_named_by_what_they_are_for(tmp_path, monkeypatch):
    builder = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is missing (extra dev)")

    def compiled(command, *, env=None, **_options):
        if env is not None:
            assert env["NUMBA_CPU_NAME"] == "a processor" and env["NUMBA_CPU_FEATURES"] == ""
            for name in ("rain/a.py311.nbi", "rain/a.py311.1.nbc", "rain/a.lock", "x.complete", "x.compiling"):
                file = Path(env["NUMBA_CACHE_DIR"], name)
                file.parent.mkdir(exist_ok=True)
                file.write_bytes(b"code")
        return subprocess.CompletedProcess(command, 0, "a processor\n", "")

    monkeypatch.setattr(subprocess, "run", compiled)
    monkeypatch.setenv("GSRAIN_COMPILED_KERNELS", "1")
    made = Path(next(builder.WheelBuilder(str(REPOSITORY)).build(directory=str(tmp_path), versions=["standard"])))
    assert re.fullmatch(rf"gsrain-[\d.]+-cp3{sys.version_info.minor}-none-manylinux_2_28_\w+\.whl", made.name)
    names = {each for each in zipfile.ZipFile(made).namelist() if "compiled_kernels" in each}
    folder = "gsrain_engine/compiled_kernels"
    assert names == {f"{folder}/{each}" for each in ("rain/a.py311.nbi", "rain/a.py311.1.nbc", "x.complete")}


def test_data_is_found_in_a_checkout_and_where_it_is_installed(tmp_path, monkeypatch):
    assert shipped_path("shaders") == REPOSITORY / "shaders"
    assert "published" in shipped_config_names("calibrations")
    (tmp_path / "gsrain_engine" / "sample_configs" / "calibrations").mkdir(parents=True)
    (tmp_path / "gsrain_engine" / "sample_configs" / "calibrations" / "own.yaml").touch()
    monkeypatch.setattr("gsrain_engine.presets.__file__", str(tmp_path / "gsrain_engine" / "shipped_configs.py"))
    assert shipped_config_names("calibrations") == ["own"]


def test_the_newest_release_among_the_changes_is_this_version():
    version = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    newest = re.search(r"^## (?!Unreleased)(\S+)", (REPOSITORY / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert newest is not None
    assert newest[1] == version
