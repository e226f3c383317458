"""Outputs that can't be written are reported before the work."""

import os
import shlex
from pathlib import Path

import pytest

from app.main import BAD_INPUT, app, run
from app.outputs import check_scene_folder, check_writable
from gsrain_engine.scene.files import file_word, name_problem, shortened

OUTPUTS = {
    "render": ["street -o OUT.png", "street -o ok.png --json OUT"],
    "info": ["street --json OUT", "street --overlay OUT.png"],
    "edit": ["none -o OUT"],
    "convert": ["none.ply OUT.ply", "none.ply ok.ply --json OUT"],
    "street": ["OUT", "ok --json OUT"],
    "export-rain": ["street -o OUT.ply", "none -o ok --json OUT"],
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
    "drive": ["-o OUT", "-o ok --json OUT"],
    "doctor": ["--json OUT"],
    "schema": ["rain -o OUT.json"],
    "bench": ["--json OUT"],
    "bench render": ["--json OUT"],
    "bench loading": ["--json OUT"],
    "bench recoloring": ["--json OUT"],
    "evaluate streaks": ["none --json OUT"],
    "evaluate consistency": ["none --contact-sheet OUT.png", "none --report OUT.html", "none --json OUT"],
    "evaluate fid": ["none none --report OUT.html", "none none --json OUT"],
    "evaluate transfers": ["paper -o OUT", "paper -o ok --json OUT"],
    "evaluate images": ["none none --report OUT.html", "none none --json OUT"],
    "evaluate lpips-weights": ["none -o OUT.npz"],
    "evaluate inception-weights": ["none -o OUT.npz"],
    "evaluate detection": ["--detector x -o OUT", "--detector x --video OUT.mp4", "--detector x --json OUT"],
    "evaluate lidar": ["none -o OUT", "none -o ok --json OUT"],
}
"""Command lines with OUT in each place of a file or folder that is written; what they read is not there."""
_WRITTEN = {"output", "target", "directory", "json", "contact_sheet", "plot", "report", "video", "overlay"}
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
    found = dict(commands())
    assert set(OUTPUTS) == set(found)
    for name, command in found.items():
        fields = {each.field_info.name for each in command.assemble_argument_collection()} & _WRITTEN
        # `video` of drive is a switch
        assert len(OUTPUTS[name]) == len(fields - ({"video"} if name == "drive" else set())), (name, fields)


@pytest.mark.parametrize("line", LINES)
def test_names_that_no_disk_takes_are_refused_before_anything_is_read(line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(shlex.split(line.replace("OUT", "雨" * 90))) == BAD_INPUT
    (said,) = capsys.readouterr().err.splitlines()
    assert "雨" in said and "bytes, and the disk takes" in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("line", LINES)
def test_what_is_in_the_way_is_told_before_anything_is_read(line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("mine")
    words = shlex.split(line.replace("OUT", "file/below/x"))
    assert run(words) == BAD_INPUT
    (said,) = capsys.readouterr().err.splitlines()
    assert "file/below/x" in said and "file is a file" in said
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_two_outputs_have_two_places(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path)
    check_writable(tmp_path / "a", tmp_path / "b", folders=[tmp_path])
    for pair in ((tmp_path / "a", tmp_path / "a"), (tmp_path / "a", tmp_path / "link" / "a")):
        with pytest.raises(ValueError, match="two outputs have this name"):
            check_writable(*pair)
    with pytest.raises(ValueError, match=r"a/b: can't be written, for .*a is to be a file"):
        check_writable(tmp_path / "a" / "b", tmp_path / "a")
    check_writable(Path(os.devnull), Path(os.devnull))


def test_a_folder_is_no_file_and_a_file_no_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="it is a folder; expected the name of a file"):
        check_writable(tmp_path)
    with pytest.raises(ValueError, match="it is a file; expected the name of a folder"):
        check_writable(folders=[tmp_path / "file"])
    with pytest.raises(ValueError, match="empty name"):
        check_writable(Path())


def test_long_names_are_shortened_and_stay_apart():
    long = "雨" * 300
    assert shortened("short") == "short" and file_word("a/b:c") == "a-b-c" and file_word("...") == "-"
    assert shortened(long) == shortened(long) != shortened(long + "a")
    assert len(os.fsencode(shortened(long, 100))) <= 100
    assert os.fsencode(file_word(os.fsdecode(b"\xfc"))) == b"\xfc"
    assert shortened("\ud800") == "?"
    assert name_problem(Path("x" * 255)) is None and "256 bytes" in name_problem(Path("x" * 256))
    assert "path has" in name_problem(Path("/".join(["x" * 200] * 25)))
    assert "zero byte" in name_problem(Path("a\0b"))


def test_a_scene_folder_takes_the_place_of_another_and_of_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "scene").mkdir()
    check_scene_folder(tmp_path / "scene")
    (tmp_path / "scene" / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="expected a new folder, or a scene folder to replace"):
        check_scene_folder(tmp_path / "scene")
    (tmp_path / "scene" / "scene.json").write_text("{}")
    check_scene_folder(tmp_path / "scene")
    with pytest.raises(ValueError, match=r"a\.ply: expected a scene folder, such as .*/a; gsrain convert"):
        check_scene_folder(tmp_path / "a.ply")


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="a folder that takes no file, whoever asks, is Linux's")
def test_a_folder_that_takes_no_file_is_named() -> None:
    with pytest.raises(ValueError, match=r"/proc/out: can't be written, for /proc takes no file \("):
        check_writable(Path("/proc/out"))
