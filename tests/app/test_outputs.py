"""Outputs that can't be written are reported before the work."""

import os
import shlex
from pathlib import Path

import pytest

from app.main import BAD_INPUT, app, installed, run
from app.outputs import check_scene_folder, check_writable
from gsrain_engine import plugins

OUTPUTS = {
    "render": ["street -o OUT.png", "street -o ok.png --json OUT"],
    "info": ["street --json OUT", "street --overlay OUT.png"],
    "edit": ["none -o OUT"],
    "convert": ["none.ply OUT.ply", "none.ply ok.ply --json OUT"],
    "publish": ["none -o OUT.html", "none -o ok.html --json OUT"],
    "export-rain": ["street -o OUT.ply", "none -o ok --json OUT"],
    "dataset": ["none -o OUT", "none -o ok --json OUT"],
    "calibrate": ["none -o OUT.yaml", "none -o ok.yaml --plot OUT.png", "none -o ok.yaml --json OUT"],
    "disdrometer": ["-o OUT.nc", "--json OUT"],
    "reconstruct": ["none -o OUT", "none -o ok --report OUT.html", "none -o ok --json OUT"],
    "transfer": ["none -o OUT", "none -o ok --contact-sheet OUT.png", "none -o ok --json OUT"],
    "recolor": [
        "none --images x -o OUT",
        "none --images x -o ok --report OUT.html",
        "none --images x -o ok --json OUT",
    ],
    "sweep": ["tiny -o OUT", "tiny -o ok --json OUT"],
    "train-transfer": ["tiny -o OUT", "tiny -o ok --json OUT"],
    "drive": ["-o OUT", "-o ok --json OUT", "-o ok --rerun OUT.rrd"],
    "doctor": ["--json OUT"],
    "schema": ["rain -o OUT.json"],
    "serve": ["none --json OUT"],
    "bench": ["--json OUT"],
    "bench render": ["--json OUT"],
    "bench loading": ["--json OUT"],
    "bench recoloring": ["--json OUT"],
    "evaluate consistency": ["none --contact-sheet OUT.png", "none --report OUT.html", "none --json OUT"],
    "evaluate fid": ["none none --report OUT.html", "none none --json OUT"],
    "evaluate transfers": ["paper -o OUT", "paper -o ok --json OUT"],
    "evaluate images": ["none none --report OUT.html", "none none --json OUT"],
    "evaluate lpips-weights": ["none -o OUT.npz"],
    "evaluate inception-weights": ["none -o OUT.npz"],
    "evaluate detection": ["--detector x -o OUT", "--detector x --video OUT.mp4", "--detector x --json OUT"],
    "evaluate lidar": ["none -o OUT", "none -o ok --json OUT"],
}
_OF_FOLDERS = {"night": ["none.ply -o OUT", "none.ply -o ok --json OUT"], "street": ["OUT", "ok --json OUT"]}
OUTPUTS |= {name: _OF_FOLDERS[name] for name in _OF_FOLDERS if plugins.find_extension(plugins.COMMANDS, name)}
"""Command lines with OUT in each place of a file or folder that is written; what they read is not there."""
_WRITTEN = {"output", "target", "directory", "json", "contact_sheet", "plot", "report", "video", "overlay", "rerun"}
needs_proc = pytest.mark.skipif(not Path("/proc").is_dir(), reason="a folder that takes no file is Linux's")
LINES = [f"{command} {rest}" for command, lines in OUTPUTS.items() for rest in lines]


def commands(of=app, before=""):
    for name in of:
        if name.startswith("-"):
            continue
        inner = of[name]
        if any(not each.startswith("-") for each in inner):
            yield from commands(inner, f"{before}{name} ")
        if inner.default_command is not None:
            yield f"{before}{name}", inner


def test_the_table_has_every_output_of_every_command():
    with installed(app, plugins.COMMANDS):
        found = dict(commands())
    assert set(found) <= set(OUTPUTS)
    for name, command in found.items():
        fields = {each.field_info.name for each in command.assemble_argument_collection()} & _WRITTEN
        # `video` of drive is a switch
        assert len(OUTPUTS[name]) == len(fields - ({"video"} if name == "drive" else set())), (name, fields)


FIRST_LINES = [f"{command} {lines[0]}" for command, lines in OUTPUTS.items()]


@pytest.mark.parametrize(
    ("line", "name", "reason"),
    [
        *((line, "file/below/x", "file is a file") for line in LINES),
        *((line, "雨" * 90, "the disk takes") for line in FIRST_LINES),
    ],
)
def test_places_that_no_file_can_have_are_refused_before_anything_is_read(
    line, name, reason, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("mine")
    assert run(shlex.split(line.replace("OUT", name))) == BAD_INPUT
    (error,) = capsys.readouterr().err.splitlines()
    assert name[:20] in error and reason in error
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_outputs_that_can_be_written(tmp_path):
    check_writable(tmp_path / "a", tmp_path / "b", folders=[tmp_path])
    check_writable(Path(os.devnull), Path(os.devnull))
    for files in ((), ("notes.txt", "scene.json")):  # a new folder, and a scene folder to replace
        (tmp_path / "scene").mkdir(exist_ok=True)
        for file in files:
            (tmp_path / "scene" / file).write_text("{}")
        check_scene_folder(tmp_path / "scene")


@pytest.mark.parametrize(
    ("files", "folders", "words"),
    [
        (["a", "a"], [], "two outputs"),
        (["a", "link/a"], [], "two outputs"),
        (["a/b", "a"], [], "a is to be a file"),
        (["."], [], "it is a folder"),
        ([], ["file"], "it is a file"),
        pytest.param(["/proc/out"], [], "/proc takes no file", marks=needs_proc),
    ],
)
def test_outputs_that_can_not_be_written(files, folders, words, tmp_path):
    (tmp_path / "link").symlink_to(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match=words):
        check_writable(*(tmp_path / each for each in files), folders=[tmp_path / each for each in folders])
    with pytest.raises(ValueError, match="empty name"):
        check_writable(Path())
    with pytest.raises(ValueError, match="a scene folder to replace"):
        check_scene_folder(tmp_path)
    with pytest.raises(ValueError, match=r"a\.ply: expected a scene folder"):
        check_scene_folder(tmp_path / "a.ply")
