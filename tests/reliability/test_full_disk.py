"""A disk that takes no more in the middle of a write: what was there stays, nothing half is left, one sentence says so.

The system refuses whatever would make a file larger than a limit, as a full disk does; `broken_commands.py` fills one.
"""

import errno
import shutil
from concurrent.futures import wait
from contextlib import contextmanager

import pytest

from app.main import run
from gsrain_engine.editor import autosave
from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from reliability.commands import complaints, leftovers
from small_scene import small_scene

resource = pytest.importorskip("resource")

CLIP = ("--size", "96x64", "--fps", "10", "--rain", "8.5", "--backend", "cpu")


@contextmanager
def files_of_at_most(size):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(autouse=True)
def own_folders(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture(scope="module")
def scene_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes") / "road"
    write_scene(small_scene("road"), folder)
    assert run(["render", str(folder), "-o", str(folder.parent / "first.npy"), *CLIP]) == 0  # fills Numba's cache
    return folder


def bytes_in(folder):
    return {str(each.relative_to(folder)): each.read_bytes() for each in folder.rglob("*") if each.is_file()}


@pytest.mark.parametrize("is_there", [False, True])
@pytest.mark.parametrize("name", ["a.ply", "a.splat", "a.spz", "scene"])
def test_an_export_leaves_what_was_there(scene_folder, tmp_path, capsys, name, is_there):
    results = tmp_path / "results"
    results.mkdir()
    if is_there:
        assert run(["convert", str(scene_folder), str(results / name)]) == 0
    before = bytes_in(results)
    if is_there and name == "scene":
        for file in results.rglob("*.ply"):  # it is another scene: its files are written anew
            file.write_bytes(file.read_bytes() + b"\0")
        before = bytes_in(results)
    capsys.readouterr()
    with files_of_at_most(2000):
        code = run(["convert", str(scene_folder), str(results / name)])
    assert code == 2
    assert capsys.readouterr().err == f"gsrain: {results / name}: File too large\n"
    assert bytes_in(results) == before
    assert not leftovers(results)


@pytest.mark.parametrize(("output", "reason"), [
    ("a.mp4", "File too large"), ("a.webm", "File too large"), ("frames", "File too large"), ("exr", ""),
    ("a.npy", "the disk took only a part of it; is there no space left?"),
])  # fmt: skip
def test_a_recording_says_how_far_it_came_and_stays_whole(scene_folder, tmp_path, capsys, output, reason):
    results = tmp_path / "results"
    results.mkdir()
    more = ["--codec", "exr"] if output == "exr" else []
    with files_of_at_most(1500):
        assert run(["render", str(scene_folder), "-o", str(results / output), *CLIP, *more]) == 2
    (said,) = capsys.readouterr().err.splitlines()[-1:]
    assert said.startswith(f"gsrain: {results / output} can't be written on after ")
    assert reason in said
    assert not complaints(results) and not leftovers(results)


def test_numbers_of_an_earlier_run_stay(scene_folder, tmp_path, capsys):
    numbers = tmp_path / "numbers.json"
    line = ["render", str(scene_folder), "-o", str(tmp_path / "a.png"), "--size", "32x32", "--backend", "cpu"]
    assert run([*line, "--json", str(numbers)]) == 0
    before = numbers.read_bytes()
    with files_of_at_most(len(before) - 100):
        assert (
            run([*line[:3], str(tmp_path / "b.png"), "--size", "1x1", "--backend", "cpu", "--json", str(numbers)]) == 2
        )
    assert numbers.read_bytes() == before
    assert capsys.readouterr().err.splitlines()[-1] == f"gsrain: {numbers}: File too large"


def settle(editor):
    for _ in range(4):
        wait(editor.pending_files, timeout=60)
        editor.tick(0.0)
        editor.apply(DrawResult(is_pending_ready=True))


@pytest.fixture
def editor(scene_folder, tmp_path):
    home = tmp_path / "home" / "road"
    shutil.copytree(scene_folder, home)
    opened = Editor()
    opened.files.open(str(home))
    settle(opened)
    yield opened
    opened.files.give_up()
    opened.close()


def duplicated(editor):
    """A change that has to be written: Gaussians that are in no file."""
    for each in editor.document.scene.members:
        g = each.gaussians
        editor.document.edit(
            "Paler",
            replace_scene,
            editor.document.scene.with_member(each.key, gaussians=g.with_sh(g.sh * g.sh.dtype.type(0.5))),
        )


def keep_now(editor):
    editor.tick(0.0)
    late = editor.files.recovery.now() + editor.preferences.value.autosave_s
    editor.files.recovery.now = lambda: late
    settle(editor)


def test_a_save_leaves_the_old_scene_and_the_changes(editor):
    home = editor.files.home
    before = bytes_in(home)
    duplicated(editor)
    with files_of_at_most(4000):
        editor.files.save()
        settle(editor)
    assert editor.status.problem == f"{home} can't be saved: File too large"
    assert editor.files.has_changes
    assert bytes_in(home) == before and not leftovers(home.parent)
    editor.files.save()
    settle(editor)
    assert not editor.files.has_changes
    read_scene(home)


def test_an_autosave_goes_to_another_disk_where_that_of_the_scene_is_full(editor, tmp_path, monkeypatch):
    home, write = editor.files.home, autosave.write_scene_folder

    def full_beside_the_scene(scene, folder, *rest, **options):
        if folder.is_relative_to(home.parent):
            raise OSError(errno.ENOSPC, "No space left on device")
        write(scene, folder, *rest, **options)

    monkeypatch.setattr(autosave, "write_scene_folder", full_beside_the_scene)
    duplicated(editor)
    keep_now(editor)
    assert editor.status.problem is None
    assert not autosave.autosave_folder(home).exists()
    (kept,) = (tmp_path / "state" / "gsrain" / "unsaved").iterdir()
    read_scene(kept / "scene")
    editor.document.undo()
    keep_now(editor)
    assert list((tmp_path / "state" / "gsrain" / "unsaved").iterdir()) == [kept]


def test_an_autosave_that_fits_nowhere_leaves_nothing_half(editor, tmp_path):
    home = editor.files.home
    duplicated(editor)
    with files_of_at_most(4000):
        keep_now(editor)
    assert editor.status.problem == "The autosave can't be written: File too large"
    assert not autosave.autosave_folder(home).exists() or not leftovers(autosave.autosave_folder(home))
    assert not list((tmp_path / "state" / "gsrain" / "unsaved").iterdir())
