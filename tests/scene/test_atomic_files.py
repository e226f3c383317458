import pytest

from gsrain_engine.scene.files import whole_file


def test_missing_folders_are_made(tmp_path):
    path = tmp_path / "new" / "folder" / "file.txt"
    with whole_file(path) as beside:
        beside.write_text("whole", encoding="utf-8")
    assert path.read_text(encoding="utf-8") == "whole"
    assert [each.name for each in path.parent.iterdir()] == ["file.txt"]


def test_what_fails_leaves_what_was_there(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("before", encoding="utf-8")
    with pytest.raises(RuntimeError), whole_file(path) as beside:
        beside.write_text("half", encoding="utf-8")
        raise RuntimeError
    assert path.read_text(encoding="utf-8") == "before"
    assert list(tmp_path.iterdir()) == [path]
