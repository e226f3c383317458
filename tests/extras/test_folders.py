"""Each folder of the extras can be deleted with its tests and its rows in pyproject.toml: nothing else names it."""

import re
import tomllib

import pytest

from app.main import BAD_INPUT, run
from gsrain_engine import plugins
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.simulation.serving.protocols import protocol_names
from repository import REPOSITORY
from small_scene import small_scene

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
    there, names = plugins.find_extensions, protocol_names()
    if "alpasim" not in names:
        pytest.skip("its folder was deleted")

    def without_alpasim(group):
        return tuple(each for each in there(group) if each.name != "alpasim")

    monkeypatch.setattr("gsrain_engine.simulation.serving.protocols.find_extensions", without_alpasim)
    monkeypatch.setattr(plugins, "find_extensions", without_alpasim)
    assert run(["serve"]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    others = ", ".join(each for each in names if each != "alpasim")
    assert line == f"gsrain: --protocol alpasim: there is {others or 'none'}"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("convert {scene} {out}.usdz", "must end in .compressed.ply, .ply, .splat, .spz, .sog or .glb"),
        ("info {out}.usdz", "no known scene format"),
        ("drive --export xosc -o {out}", "--export xosc: there is only parquet"),
        ("drive --export ros2 -o {out}", "--export ros2: there is only parquet"),
        ("drive --rerun {out}.rrd -o {out}", "--rerun: there is only parquet"),
        ("drive {out}.xosc -o {out}", "no installed package reads .xosc scenarios"),
    ],
)
def test_without_any_row_formats_are_unknown(words, sentence, tmp_path, capsys, monkeypatch):
    for place in ("plugins", "scene.formats.registry", "simulation.drive_exports", "simulation.scenario_io"):
        monkeypatch.setattr(f"gsrain_engine.{place}.find_extensions", lambda group: ())
    scene, out = tmp_path / "scene", tmp_path / "out"
    write_scene(small_scene(), scene)
    out.with_suffix(".usdz").write_bytes(b"PK")
    out.with_suffix(".xosc").write_text("<?xml version='1.0'?>\n<OpenSCENARIO/>")
    assert run(words.format(scene=scene, out=out).split()) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert sentence in line, line
