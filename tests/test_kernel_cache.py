import multiprocessing
import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from llvmlite import binding

from gsrain_engine import compile_cache as cache
from gsrain_engine.compile_cache import has_kernels, kernel_cache, mark_kernels, use_kernel_cache
from gsrain_engine.editor.drawing.textures import compile_kernels


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    folder = tmp_path / "raster"
    folder.mkdir()
    (folder / "a.py").write_text("x = 1\n")
    return folder


def test_a_change_of_any_source_leads_to_another_folder(tmp_path, sources):
    root, held = tmp_path / "cache", set()
    held.add(kernel_cache(root, "1", [sources]))
    held.add(kernel_cache(root, "1", [sources]))
    assert len(held) == 1
    (sources / "a.py").write_text("x = 10\n")
    held.add(kernel_cache(root, "1", [sources]))
    os.utime(sources / "a.py", ns=(5, 5))
    held.add(kernel_cache(root, "1", [sources]))
    (sources / "b.py").write_text("")
    held.add(kernel_cache(root, "1", [sources]))
    held.add(kernel_cache(root, "2", [sources]))
    assert len(held) == 5
    (sources / "notes.txt").write_text("")
    (sources / ".#a.py").symlink_to("nowhere")  # an editor's lock
    assert kernel_cache(root, "2", [sources]) in held
    assert all(folder.parent == root and folder.is_dir() for folder in held)


def test_the_two_used_last_stay_and_old_ones_go(tmp_path, sources):
    root, hours_ago = tmp_path / "cache", time.time() - 7200
    folders = [kernel_cache(root, str(version), [sources]) for version in range(4)]
    for age, folder in enumerate(folders):
        (folder / "kernel.nbc").write_bytes(b"code")
        os.utime(folder, (hours_ago - age, hours_ago - age))
    assert kernel_cache(root, "3", [sources]) == folders[3]  # now the newest
    assert [folder.is_dir() for folder in folders] == [True, False, False, True]
    assert (folders[3] / "kernel.nbc").is_file()


def test_a_place_that_cannot_be_written_is_no_error(tmp_path, sources):
    (tmp_path / "file").write_text("")
    assert kernel_cache(tmp_path / "file" / "cache", "1", [sources]).parent == tmp_path / "file" / "cache"


def _start_again_and_again(root: Path, sources: Path, first: int) -> None:
    for version in range(first, first + 200):
        kernel_cache(root, str(version % 7), [sources])
        for folder in root.iterdir():
            with suppress(OSError):
                os.utime(folder, (1, 1))  # old at once: the other processes are about to remove it


def test_processes_may_make_and_remove_folders_at_once(tmp_path, sources):
    spawn = multiprocessing.get_context("spawn")
    arguments = [(tmp_path / "cache", sources, first) for first in range(3)]
    running = [spawn.Process(target=_start_again_and_again, args=each) for each in arguments]
    for process in running:
        process.start()
    for process in running:
        process.join(60)
    assert [process.exitcode for process in running] == [0, 0, 0]


def cache_folder(**environment: str) -> str:
    code = "import os, gsrain_engine; print(os.environ['NUMBA_CACHE_DIR'])"
    kept = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=kept | environment, capture_output=True, text=True, check=True, timeout=60
    )
    return done.stdout.strip()


def test_a_users_own_folder_stays_and_a_parents_is_looked_up_again(tmp_path):
    cache = str(tmp_path / "home")
    own = cache_folder(XDG_CACHE_HOME=cache)
    assert cache_folder(XDG_CACHE_HOME=cache, NUMBA_CACHE_DIR=str(tmp_path / "mine")) == str(tmp_path / "mine")
    stale = str(Path(own).parent / "0123456789abcdef")
    assert cache_folder(XDG_CACHE_HOME=cache, NUMBA_CACHE_DIR=stale) == own


def test_knows_whether_all_kernels_have_been_compiled(tmp_path, sources, monkeypatch):
    monkeypatch.setattr(cache, "FRAME_SOURCES", (sources,))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    mark_kernels()
    assert not has_kernels()  # Numba keeps them where it likes
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    (tmp_path / "raster_1").mkdir()
    (tmp_path / "raster_1" / "tiles.count.nbi").touch()
    assert not has_kernels()  # one is not all
    mark_kernels()
    assert has_kernels()
    monkeypatch.setattr(binding, "get_host_cpu_name", lambda: "another")
    assert not has_kernels()


def test_a_frames_kernels_are_marked_once_they_are_compiled(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert not has_kernels()
    compile_kernels()
    assert has_kernels()


def test_kernels_of_other_sources_are_not_these(tmp_path, sources, monkeypatch):
    monkeypatch.setattr(cache, "FRAME_SOURCES", (sources,))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    mark_kernels()
    (sources / "a.py").write_text("x = 10\n")
    assert not has_kernels()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "cache"))
    (tmp_path / "file").touch()
    mark_kernels()
    assert not has_kernels()


@pytest.fixture
def own_places(tmp_path, monkeypatch):
    """Cache and temporary files of this test alone."""
    for name in ("cache", "tmp"):
        (tmp_path / name).mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(cache.tempfile, "tempdir", str(tmp_path / "tmp"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "set back in the end")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    return tmp_path


def chosen():
    os.environ.pop("NUMBA_CACHE_DIR", None)
    use_kernel_cache()
    return Path(os.environ["NUMBA_CACHE_DIR"])


@pytest.mark.skipif(sys.platform != "linux", reason="places as Linux has them")
def test_a_full_disk_leads_kernels_to_temporary_files_of_this_user_alone(own_places, monkeypatch):
    usual = chosen()
    assert usual.is_relative_to(own_places / "cache")
    monkeypatch.setattr(cache, "ROOM_BYTES", 1 << 62)
    other = chosen()
    assert other.is_relative_to(own_places / "tmp")
    root = other.parent
    assert root.stat().st_mode & 0o077 == 0
    (usual / "kernel.nbi").write_bytes(b"index.")
    assert chosen() == usual  # what is there needs no room
    (usual / "kernel.nbi").unlink()
    root.chmod(0o777)  # Numba runs what it finds: not what others can have put there
    assert chosen() == usual


@pytest.mark.skipif(sys.platform != "linux", reason="places as Linux has them")
@pytest.mark.parametrize("torn", [b"", b"\x80\x04half"])
def test_what_a_power_cut_has_torn_is_compiled_again(own_places, torn):
    folder = chosen() / "raster_12"
    folder.mkdir()
    for name, data in {"whole.nbi": b"\x80\x04N.", "torn.nbi": torn, "torn.1.nbc": torn, "notes.txt": b""}.items():
        (folder / name).write_bytes(data)
    mark_kernels()
    chosen()
    assert sorted(each.name for each in folder.iterdir()) == ["notes.txt", "whole.nbi"]
    assert not has_kernels()
