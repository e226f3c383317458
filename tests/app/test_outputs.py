"""What can't be written is said before the work."""

from pathlib import Path

import pytest

from app.commands.outputs import check_scene_folder, check_writable, report_beside


def test_what_can_be_written_is_not_touched(tmp_path: Path) -> None:
    check_scene_folder(tmp_path / "new" / "scene")
    check_writable(None, tmp_path / "new" / "numbers.json", Path("here.json"))
    assert not list(tmp_path.iterdir())


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


def test_a_file_in_the_way_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    for check in (check_scene_folder, check_writable):
        with pytest.raises(ValueError, match=r"file/deep/out: can't be written, for .*/file is a file"):
            check(tmp_path / "file" / "deep" / "out")


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="a folder that takes no file, whoever asks, is Linux's")
def test_a_folder_that_takes_no_file_is_named() -> None:
    with pytest.raises(ValueError, match=r"/proc/out: can't be written, for /proc takes no file \("):
        check_writable(Path("/proc/out"))


def test_a_report_lies_beside_its_scene() -> None:
    assert report_beside(Path("a/scene"), None) == Path("a/scene.report.html")
    assert report_beside(Path("a/scene"), Path("b.html")) == Path("b.html")
