"""A disk that becomes full during a write: older files stay, nothing partial is left, one sentence is printed.

The system refuses to make a file larger than a limit, as a full disk does; `broken_commands.py` fills one.
"""

import errno
import shutil
from contextlib import contextmanager

import pytest

from app.main import run
from gsrain_engine.editor import autosave
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from reliability.commands import complaints, leftovers
from reliability.editors import autosave_now, opened, settle
from small_scene import small_scene

resource = pytest.importorskip("resource")

STILL = ("--size", "96x64", "--rain", "8.5", "--backend", "cpu")
CLIP = (*STILL, "--fps", "10")


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
    assert run(["render", str(folder), "-o", str(folder.parent / "first.npy"), *STILL]) == 0  # fills Numba's cache
    return folder


def bytes_in(folder):
    return {str(each.relative_to(folder)): each.read_bytes() for each in folder.rglob("*") if each.is_file()}


@pytest.mark.parametrize("is_there", [False, True])
@pytest.mark.parametrize("name", ["a.ply", "a.splat", "a.spz", "scene"])
def test_exports_leave_older_files(scene_folder, tmp_path, capsys, name, is_there):
    results = tmp_path / "results"
    results.mkdir()
    if is_there:
        assert run(["convert", str(scene_folder), str(results / name)]) == 0
        capsys.readouterr()
    for file in (results / "scene").rglob("*.ply"):  # of another scene, so that its files are written anew
        file.write_bytes(file.read_bytes() + b"\0")
    before = bytes_in(results)
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
def test_videos_stay_readable(scene_folder, tmp_path, capsys, output, reason):
    results = tmp_path / "results"
    results.mkdir()
    options = [*CLIP, "--codec", "exr"] if output == "exr" else STILL if output.endswith(".npy") else CLIP
    with files_of_at_most(1500):
        assert run(["render", str(scene_folder), "-o", str(results / output), *options]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith(f"gsrain: {results / output} can't be written on after ") and reason in error
    assert not complaints(results) and not leftovers(results)


def test_numbers_of_an_earlier_run_stay(scene_folder, tmp_path, capsys):
    numbers = tmp_path / "numbers.json"

    def rendered(size):
        options = ["--size", size, "--backend", "cpu", "--json", str(numbers)]
        return run(["render", str(scene_folder), "-o", str(tmp_path / f"{size}.png"), *options])

    assert rendered("32x32") == 0
    before = numbers.read_bytes()
    with files_of_at_most(len(before) - 100):
        assert rendered("1x1") == 2
    assert numbers.read_bytes() == before
    assert capsys.readouterr().err.splitlines()[-1] == f"gsrain: {numbers}: File too large"


@pytest.fixture
def editor(scene_folder, tmp_path):
    """An editor with changes that are in no file."""
    home = tmp_path / "home" / "road"
    shutil.copytree(scene_folder, home)
    found = opened(home)
    for each in found.document.scene.members:
        paler = each.gaussians.with_sh(each.gaussians.sh * each.gaussians.sh.dtype.type(0.5))
        found.document.edit("Paler", replace_scene, found.document.scene.with_member(each.key, gaussians=paler))
    yield found
    found.files.give_up()
    found.close()


def test_saves_leave_the_old_scene_and_the_changes(editor):
    home = editor.files.home
    before = bytes_in(home)
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


def test_autosaves_move_to_another_disk(editor, tmp_path, monkeypatch):
    home, write = editor.files.home, autosave.write_scene_folder

    def full_beside_the_scene(scene, folder, *rest, **options):
        if folder.is_relative_to(home.parent):
            raise OSError(errno.ENOSPC, "No space left on device")
        write(scene, folder, *rest, **options)

    monkeypatch.setattr(autosave, "write_scene_folder", full_beside_the_scene)
    autosave_now(editor)
    assert editor.status.problem is None
    assert not autosave.autosave_folder(home).exists()
    (saved,) = (tmp_path / "state" / "gsrain" / "unsaved").iterdir()
    read_scene(saved / "scene")
    editor.document.undo()
    autosave_now(editor)
    assert list((tmp_path / "state" / "gsrain" / "unsaved").iterdir()) == [saved]


def test_autosaves_without_space_leave_nothing(editor, tmp_path):
    home = editor.files.home
    with files_of_at_most(4000):
        autosave_now(editor)
    assert editor.status.problem == "The autosave can't be written: File too large"
    assert not autosave.autosave_folder(home).exists() or not leftovers(autosave.autosave_folder(home))
    assert not list((tmp_path / "state" / "gsrain" / "unsaved").iterdir())
