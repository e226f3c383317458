"""Files that appear complete: behind links, after killed writers, with two writers of one place."""

import errno
import json
import os
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest

from app.main import BAD_INPUT, run
from gsrain_engine.safe_io.files import PathInUseError, hold_for_writing, lock_file, lock_path, whole_file, whole_folder
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene

posix = pytest.mark.skipif(os.name != "posix", reason="needs links, permissions and locks as POSIX has them")


def write(path, text="new"):
    with whole_file(path) as beside:
        beside.write_text(text)


@posix
def test_links_and_pipes_stay(tmp_path):
    real, link, pipe = tmp_path / "far" / "real.txt", tmp_path / "link.txt", tmp_path / "pipe"
    real.parent.mkdir()
    real.write_text("old")
    real.chmod(0o600)
    link.symlink_to(real)
    write(link)
    assert link.is_symlink() and real.read_text() == "new"
    assert stat.S_IMODE(real.stat().st_mode) == 0o600
    os.mkfifo(pipe)
    with ThreadPoolExecutor() as reader:
        heard = reader.submit(pipe.read_text)
        write(pipe)
        assert heard.result(timeout=10) == "new"
    assert pipe.is_fifo()


def test_old_temporary_files_are_removed(tmp_path):
    old, new, other = (tmp_path / name for name in (".a.ply.01dc11b5.part", ".b.ply.0e3c11b5.part", ".mine.part"))
    for part in (old, new, other):
        part.write_text("half")
    (tmp_path / ".scene.00c0ffee.part" / "layers").mkdir(parents=True)
    for part in (old, other, tmp_path / ".scene.00c0ffee.part" / "layers", tmp_path / ".scene.00c0ffee.part"):
        os.utime(part, (0, 0))
    write(tmp_path / "c.txt")
    assert sorted(each.name for each in tmp_path.iterdir()) == sorted([new.name, other.name, "c.txt"])


@posix
def test_locked_folders_stay_at_any_age(tmp_path):
    held, forgotten = tmp_path / ".held.01dc11b5.part", tmp_path / ".forgotten.01dc11b5.part"
    for part in (held, forgotten):
        part.mkdir()
        os.utime(part, (0, 0))
    with lock_path(held):
        write(tmp_path / "c.txt")
    assert held.is_dir() and not forgotten.is_dir()
    (tmp_path / "place").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "place")
    with whole_folder(tmp_path / "place" / "scene") as beside:
        (beside / "a").write_text("a")
        for part in (beside / "a", beside):
            os.utime(part, (0, 0))
        write(tmp_path / "link" / "c.txt")
        assert beside.is_dir()


@pytest.mark.parametrize("whole", [whole_file, whole_folder])
def test_errors_of_the_disk_name_the_target(tmp_path, whole):
    def full():
        with whole(tmp_path / "out") as beside:
            if whole is whole_file:
                beside.write_text("half")
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space left on device") as caught:
        full()
    assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(tmp_path / "out"))
    with pytest.raises(FileNotFoundError) as caught, whole(tmp_path / "out"):
        (tmp_path / "absent").read_text()
    assert caught.value.filename == str(tmp_path / "absent")  # an error about another file stays as it is
    assert not list(tmp_path.iterdir())


_HOLDER = """
import sys
shared = sys.argv[1:] == ["shared"]
sys.argv = ["/usr/bin/gsrain", "street", "my out \\x1b[31m"]
from pathlib import Path
from gsrain_engine.safe_io.files import hold_for_writing
with hold_for_writing(Path(sys.stdin.readline().rstrip("\\n")), shared=shared):
    print("held", flush=True)
    sys.stdin.read()
"""


@contextmanager
def another_process(place, *arguments):
    """A process that says it writes to a place, until the block ends."""
    command = [sys.executable, "-c", _HOLDER, *arguments]
    holder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with holder:
        holder.stdin.write(f"{place}\n")
        holder.stdin.flush()
        assert holder.stdout.readline() == "held\n"
        yield holder


COMMANDS = {
    "street": ["street", "{out}"],
    "transfer": ["transfer", "street", "-o", "{out}", "--rain", "5"],
    "recolor": ["recolor", "street", "--images", "absent", "-o", "{out}"],
    "reconstruct": ["reconstruct", "absent", "-o", "{out}"],
    "convert": ["convert", "{scene}", "{out}"],
    "drive": ["drive", "stationary-lead", "-o", "{out}"],
    "evaluate detection": ["evaluate", "detection", "--detector", "absent.onnx", "-o", "{out}"],
    "evaluate lidar": ["evaluate", "lidar", "-o", "{out}"],
    "evaluate transfers": ["evaluate", "transfers", "{comparison}", "-o", "{out}"],
    "train-transfer": ["train-transfer", "tiny", "-o", "{out}"],
    "render, frames": ["render", "{scene}", "-o", "{out}", "--size", "32x24", "--backend", "cpu"],
    "render, a film": ["render", "{scene}", "-o", "{out}.mp4", "--size", "32x24", "--backend", "cpu"],
    "sweep": ["sweep", "{sweep}", "-o", "{out}", "--workers", "0"],
}
"""Every command that writes a folder."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    write_scene(small_scene(), folder / "scene")
    (folder / "comparison.yaml").write_text("source: street\nreal: [absent]\nmethods: [{name: one, method: clear}]\n")
    (folder / "sweep.yaml").write_text(f"kind: render\nscenes: ['{folder / 'scene'}']\nrecording: {{output: a.png}}\n")
    files = {"scene": "scene", "comparison": "comparison.yaml", "sweep": "sweep.yaml"}
    return {name: folder / file for name, file in files.items()}


@pytest.mark.street
def test_second_commands_name_the_first_one(inputs, tmp_path, capsys):
    out = tmp_path / "out"
    with another_process(out) as holder, another_process(f"{out}.mp4") as filming:
        with pytest.raises(PathInUseError, match=f"process {holder.pid} "):
            write_scene(small_scene("mine"), out)
        for name, words in COMMANDS.items():
            assert run([word.format(out=out, **inputs) for word in words]) == BAD_INPUT, name
            error = capsys.readouterr().err.splitlines()[-1]
            pid = filming.pid if "film" in name else holder.pid
            assert f"process {pid} (gsrain street 'my out \\x1b[31m')" in error and str(out) in error, name
        assert not out.exists()


def test_locks_of_dead_processes_are_taken_over(tmp_path):
    with another_process(tmp_path / "out") as holder:
        holder.kill()
        holder.wait()
        note = json.loads(lock_file(tmp_path / "out").read_text())
        assert note["pid"] == holder.pid
        # The number of a process is given to others later: this one is not asked for by it.
        lock_file(tmp_path / "out").write_text(json.dumps(note | {"pid": os.getpid()}))
        with hold_for_writing(tmp_path / "out"):
            assert json.loads(lock_file(tmp_path / "out").read_text())["pid"] == os.getpid()
    assert list(tmp_path.iterdir()) == []


def test_shards_of_a_sweep_share_a_folder(tmp_path):
    out = tmp_path / "out"
    with another_process(out, "shared") as holder:
        with hold_for_writing(out, shared=True):
            pass
        assert lock_file(out).exists()  # the other one still has it
        with pytest.raises(PathInUseError), hold_for_writing(out):
            pass
        holder.stdin.close()
        holder.wait()
    with hold_for_writing(out):
        pass
    assert list(tmp_path.iterdir()) == []


def test_one_process_may_hold_a_place_twice(tmp_path):
    with hold_for_writing(tmp_path / "new" / "out"):
        with whole_folder(tmp_path / "new" / "out"):
            pass
        assert lock_file(tmp_path / "new" / "out").exists()
    places = [tmp_path / "other" / ("ä" * 120 + str(number)) for number in range(2)]  # the longest possible names
    assert lock_file(places[0]) != lock_file(places[1])
    for place in places:
        with hold_for_writing(place):
            assert lock_file(place).is_file()
    assert [each.name for each in tmp_path.rglob("*")] == ["new", "out"]  # folders created for a lock are removed


@pytest.mark.parametrize("kind", ["link", "second name", "pipe", "folder"])
def test_other_files_in_place_of_the_lock_stay(tmp_path, kind):
    """In a folder of several people anybody can put something in the lock's place."""
    precious, lock = tmp_path / "precious", lock_file(tmp_path / "out")
    precious.write_text("precious")
    make = {"link": lambda: lock.symlink_to(precious), "second name": lambda: lock.hardlink_to(precious),
            "pipe": lambda: os.mkfifo(lock), "folder": lock.mkdir}  # fmt: skip
    make[kind]()
    with hold_for_writing(tmp_path / "out"):
        pass
    assert precious.read_text() == "precious" and (lock.exists() or lock.is_symlink())


def test_locks_without_a_readable_note_hold(tmp_path):
    with another_process(tmp_path / "out"):
        for text in ("", "[]", '{"pid": 3}', "\xff", "[" * 3000):
            lock_file(tmp_path / "out").write_text(text, encoding="latin-1")
            with pytest.raises(PathInUseError, match="another process"), hold_for_writing(tmp_path / "out"):
                pass
