"""Each folder of the extras can be deleted with its tests and its rows in pyproject.toml: nothing else names it."""

import re
import tomllib

import pytest

from app.main import BAD_INPUT, run
from gsrain_engine import plugins
from repository import REPOSITORY

EXTRAS = REPOSITORY / "gsrain_extras"
FOLDERS = sorted(each.name for each in EXTRAS.iterdir() if (each / "__init__.py").is_file())
ROWS = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]["entry-points"]


@pytest.mark.parametrize("folder", FOLDERS)
def test_no_code_but_its_own_names_a_folder(folder):
    own = EXTRAS / folder, REPOSITORY / "tests" / "extras" / folder
    code = [
        path
        for root in ("app", "ui", "gsrain", "gsrain_engine", "gsrain_extras", "tests", "examples", "docs")
        for path in (REPOSITORY / root).rglob("*.py")
        if not any(each in path.parents for each in own)
    ]
    naming = re.compile(rf"gsrain_extras[./]{folder}\b|tests[./]extras[./]{folder}\b")
    found = {path.relative_to(REPOSITORY).as_posix() for path in code if naming.search(path.read_text("utf-8"))}
    assert found <= {"tests/safe_io/test_limits.py"}  # which lists the readers of all packages
    assert any(place.startswith(f"gsrain_extras.{folder}.") for group in ROWS.values() for place in group.values())


def test_each_row_is_installed_and_loads():
    for name, rows in ROWS.items():
        group = next(each for each in plugins.GROUPS if each.name == name)
        for row, place in rows.items():
            extension = plugins.find_extension(group, row)
            assert extension is not None and extension.place == place and extension.package == "gsrain"


def test_without_a_row_the_command_names_the_others(monkeypatch, capsys):
    there = plugins.find_extensions

    def without_alpasim(group):
        return tuple(each for each in there(group) if each.name != "alpasim")

    monkeypatch.setattr("gsrain_engine.simulation.serving.protocols.find_extensions", without_alpasim)
    monkeypatch.setattr(plugins, "find_extensions", without_alpasim)
    assert run(["serve"]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "gsrain: --protocol alpasim: there is browser, carla-canvas"
