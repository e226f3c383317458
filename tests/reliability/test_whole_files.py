"""Files that appear whole: in the place of links, under long names, and what is left of writers that were killed."""

import errno
import os
import stat
from concurrent.futures import ThreadPoolExecutor

import pytest

from gsrain_engine.scene import atomic_files
from gsrain_engine.scene.atomic_files import whole_file, whole_folder
from gsrain_engine.scene.file_lock import locked

posix = pytest.mark.skipif(os.name != "posix", reason="needs links, permissions and locks as POSIX has them")


@pytest.fixture(autouse=True)
def _nothing_is_tidied_yet(monkeypatch):
    monkeypatch.setattr(atomic_files, "_tidied", set())


def write(path, text="new"):
    with whole_file(path) as beside:
        beside.write_text(text)


@posix
def test_a_link_stays_and_what_it_leads_to_is_replaced(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "real.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to(tmp_path / "far" / "real.txt")
    write(tmp_path / "link.txt")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "far" / "real.txt").read_text() == "new"


@posix
def test_permissions_stay(tmp_path):
    (tmp_path / "own.txt").write_text("old")
    (tmp_path / "own.txt").chmod(0o600)
    write(tmp_path / "own.txt")
    assert stat.S_IMODE((tmp_path / "own.txt").stat().st_mode) == 0o600


@posix
def test_a_pipe_is_written_to_and_stays_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with ThreadPoolExecutor() as reader:
        heard = reader.submit((tmp_path / "pipe").read_text)
        write(tmp_path / "pipe")
        assert heard.result(timeout=10) == "new"
    assert (tmp_path / "pipe").is_fifo()


@pytest.mark.parametrize("name", ["n" * 255, "ä" * 127, "line\nbreak.txt"])
def test_any_name_that_a_disk_takes_will_do(tmp_path, name):
    write(tmp_path / name)
    assert [each.name for each in tmp_path.iterdir()] == [name]


def test_what_killed_writers_have_left_goes_once_it_is_old(tmp_path):
    old, new, other = (tmp_path / name for name in (".a.ply.01dc11b5.part", ".b.ply.0e3c11b5.part", ".mine.part"))
    for part in (old, new, other):
        part.write_text("half")
    (tmp_path / ".scene.00c0ffee.part" / "layers").mkdir(parents=True)
    for part in (old, other, tmp_path / ".scene.00c0ffee.part" / "layers", tmp_path / ".scene.00c0ffee.part"):
        os.utime(part, (0, 0))
    write(tmp_path / "c.txt")
    assert sorted(each.name for each in tmp_path.iterdir()) == sorted([new.name, other.name, "c.txt"])


@posix
def test_a_folder_that_somebody_writes_to_stays_whatever_the_clock_says(tmp_path):
    held, forgotten = tmp_path / ".held.01dc11b5.part", tmp_path / ".forgotten.01dc11b5.part"
    for part in (held, forgotten):
        part.mkdir()
        os.utime(part, (0, 0))
    with locked(held):
        write(tmp_path / "c.txt")
    assert held.is_dir() and not forgotten.is_dir()


@posix
def test_a_folder_that_is_being_written_is_held(tmp_path, monkeypatch):
    monkeypatch.setattr(atomic_files, "_ABANDONED_S", -1.0)  # the clock leaps
    with whole_folder(tmp_path / "scene") as beside:
        (beside / "a").write_text("a")
        monkeypatch.setattr(atomic_files, "_tidied", set())
        write(tmp_path / "c.txt")
        assert beside.is_dir()
    assert (tmp_path / "scene" / "a").read_text() == "a"


@pytest.mark.parametrize("whole", [whole_file, whole_folder])
def test_a_disk_that_refuses_is_told_with_the_name_that_a_person_knows(tmp_path, whole):
    def full():
        with whole(tmp_path / "out") as beside:
            if whole is whole_file:
                beside.write_text("half")
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space left on device") as caught:
        full()
    assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(tmp_path / "out"))
    assert not list(tmp_path.iterdir())


def test_an_error_about_another_file_stays_as_it_is(tmp_path):
    with pytest.raises(FileNotFoundError) as caught, whole_file(tmp_path / "out"):
        (tmp_path / "absent").read_text()
    assert caught.value.filename == str(tmp_path / "absent")
