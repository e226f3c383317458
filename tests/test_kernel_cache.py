"""The cache of compiled kernels: a folder for each state of the sources; and the wait of OpenMP threads.

Processes import this module, so that it imports little.
"""

import ast
import gc
import multiprocessing
import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest

from gsrain_engine import compile_cache as cache
from gsrain_engine.compile_cache import has_kernels, kernel_cache, mark_kernels, use_kernel_cache
from repository import REPOSITORY, is_compiled


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    folder = tmp_path / "raster"
    folder.mkdir()
    (folder / "a.py").write_text("x = 1\n")
    return folder


def test_every_state_of_the_sources_has_its_folder(tmp_path, sources):
    root, version = tmp_path / "cache", "1"
    folders = [kernel_cache(root, version, [sources])]
    for change in (
        lambda: (sources / "a.py").write_text("x = 10\n"),
        lambda: (sources / "b.py").write_text(""),
    ):
        assert kernel_cache(root, version, [sources]) == folders[-1]
        change()
        folders.append(kernel_cache(root, version, [sources]))
    folders.append(kernel_cache(root, "2", [sources]))
    assert len(set(folders)) == 4
    assert all(folder.parent == root and folder.is_dir() for folder in folders)
    (sources / "notes.txt").write_text("")
    (sources / ".#a.py").symlink_to("nowhere")  # an editor's lock
    os.utime(sources / "a.py", ns=(5, 5))
    elsewhere = shutil.copytree(sources, tmp_path / "installed" / sources.name, symlinks=True)
    assert kernel_cache(root, "2", [sources]) == kernel_cache(root, "2", [elsewhere]) == folders[-1]
    assert kernel_cache(root, "2", [sources / "a.py"]) != folders[-1]
    (tmp_path / "file").write_text("")
    assert kernel_cache(tmp_path / "file", "1", [sources]).parent == tmp_path / "file"  # can't be written: no error


def test_old_folders_are_removed(tmp_path, sources):
    root, hours_ago = tmp_path / "cache", time.time() - 7200
    folders = [kernel_cache(root, str(version), [sources]) for version in range(4)]
    for age, folder in enumerate(folders):
        (folder / "kernel.nbc").write_bytes(b"code")
        os.utime(folder, (hours_ago - age, hours_ago - age))
    assert kernel_cache(root, "3", [sources]) == folders[3]  # now the newest
    assert [folder.is_dir() for folder in folders] == [True, False, False, True]
    assert (folders[3] / "kernel.nbc").is_file()


def _create_folders(root: Path, sources: Path, first: int) -> None:
    for version in range(first, first + 200):
        kernel_cache(root, str(version % 7), [sources])
        for folder in root.iterdir():
            with suppress(OSError):
                os.utime(folder, (1, 1))  # old immediately: the other processes remove it


def test_processes_may_create_and_remove_folders_concurrently(tmp_path, sources):
    spawn = multiprocessing.get_context("spawn")
    running = [spawn.Process(target=_create_folders, args=(tmp_path / "cache", sources, first)) for first in range(3)]
    for process in running:
        process.start()
    for process in running:
        process.join(60)
    assert [process.exitcode for process in running] == [0, 0, 0]


def imported(name: str, **environment: str) -> str:
    """Value of a variable of the environment after the engine is imported."""
    unset = ("NUMBA_CACHE_DIR", "GOMP_SPINCOUNT", "OMP_WAIT_POLICY")
    code = f"import os, gsrain_engine; print(os.environ.get('{name}'))"
    others = {name: value for name, value in os.environ.items() if name not in unset}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=others | environment, capture_output=True, text=True, check=True).stdout.strip()


def test_folders_set_by_the_user_stay(tmp_path):
    home = {"XDG_CACHE_HOME": str(tmp_path / "home")}
    own = imported("NUMBA_CACHE_DIR", **home)
    assert imported("NUMBA_CACHE_DIR", NUMBA_CACHE_DIR=str(tmp_path / "mine"), **home) == str(tmp_path / "mine")
    outdated = str(Path(own).parent / "0123456789abcdef")  # set by a parent process
    assert imported("NUMBA_CACHE_DIR", NUMBA_CACHE_DIR=outdated, **home) == own


@pytest.mark.parametrize(
    ("own", "spins"), [({}, "20000"), ({"GOMP_SPINCOUNT": "7"}, "7"), ({"OMP_WAIT_POLICY": "active"}, "None")]
)
def test_openmp_threads_wait_briefly_unless_configured(own, spins):
    assert imported("GOMP_SPINCOUNT", **own) == spins


def test_kernels_are_marked_for_sources_and_processor(tmp_path, sources, monkeypatch):
    from llvmlite import binding

    monkeypatch.setattr(cache, "FRAME_SOURCES", (sources,))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    mark_kernels()
    assert not has_kernels()  # Numba chooses the place
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert not has_kernels()
    mark_kernels()
    assert has_kernels()
    with monkeypatch.context() as patch:
        patch.setattr(binding, "get_host_cpu_name", lambda: "another")
        assert not has_kernels()
    (sources / "a.py").write_text("x = 10\n")
    assert not has_kernels()


SHIPPED = """
import sys
from pathlib import Path
from gsrain_engine import compile_cache as cache
cache.SHIPPED_KERNELS = Path(sys.argv[1])
cache.BASELINES[cache.architecture()] = (sys.argv[2], frozenset(sys.argv[3:]))
import numpy as np
from numba.core import event
from gsrain_engine.fast_math import harmonics
with event.install_recorder("numba:compile") as recorder:
    values = harmonics(np.array([[0.6, 0.0, 0.8]], np.float32), 4)
cache.mark_kernels()
print(len(recorder.buffer), cache.has_kernels(), cache.shipped_processor(), values.tolist())
"""


def test_kernels_that_a_wheel_brings_are_read_where_they_fit(tmp_path):
    def found(cache_folder: str, *words: str, **environment: str) -> list[str]:
        command = [sys.executable, "-c", SHIPPED, *words]
        environment = {**os.environ, **environment, "NUMBA_CACHE_DIR": str(tmp_path / cache_folder)}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return done.stdout.strip().split(" ", 3)

    common = cache.BASELINES[cache.architecture()][0]
    built = found("built", "nowhere", common, NUMBA_CPU_NAME=common, NUMBA_CPU_FEATURES="")
    assert int(built[0]) > 0 and built[2] == "None"
    folder = str(tmp_path / "built")
    assert found("empty", folder, common) == ["0", "True", common, built[3]]
    assert not list((tmp_path / "empty").rglob("*.nbi"))
    for words in ((common, "a feature that no processor has"), ("another",)):  # of the processor; kernels of others
        compiled = found(f"own{len(words)}", folder, *words)
        assert int(compiled[0]) > 0 and compiled[2] == "None"
        assert np.allclose(ast.literal_eval(compiled[3]), ast.literal_eval(built[3]), atol=1e-6)


def kernels_of(path: Path) -> set[str]:
    functions = [each for each in ast.parse(path.read_bytes()).body if isinstance(each, ast.FunctionDef)]
    return {each.name for each in functions if is_compiled(each)}


def test_kernels_that_kernels_of_other_files_call_are_sources():
    root = REPOSITORY / "gsrain_engine"
    kernels = {path: found for path in root.rglob("*.py") if (found := kernels_of(path))}
    called = set()
    for path in kernels:
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.ImportFrom) and node.level and node.module:
                other = Path(path.parents[node.level - 1], *node.module.split(".")).with_suffix(".py")
                if kernels.get(other, set()) & {each.name for each in node.names}:
                    called.add(other)
    assert len(called) > 10
    assert [path for path in called if not {path, path.parent} & set(cache.FRAME_SOURCES)] == []


def test_another_installation_finds_the_kernels(tmp_path):
    """Numba's index is found from a copy of the program elsewhere, whose files are of another time."""
    find = "from gsrain_engine.simulation import controllers as c; print(c.wrap_angle_kernel._cache.cache_path)"
    copy = tmp_path / "site"
    shutil.copytree(REPOSITORY / "gsrain_engine", copy / "gsrain_engine", ignore=shutil.ignore_patterns("__pycache__"))
    places = set()
    for folder in (REPOSITORY, copy):
        own = os.environ | {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
        done = subprocess.run([sys.executable, "-P", "-c", find], env=own, capture_output=True, text=True, check=True)
        places.add(done.stdout.strip())
    assert places == {str(tmp_path / "kernels" / "simulation")}


TABLE = """
import os
import sys

import kernel_table
from gsrain_engine.compile_cache import has_kernels

os.environ["NUMBA_CACHE_DIR"] = sys.argv[1]  # of the mark; Numba goes on with its own
before = has_kernels()
rows = kernel_table.needed()
print(before, has_kernels(), *rows, sep="\\n")
"""


def test_the_table_lists_the_kernels_of_pictures_which_are_marked_after_compilation(tmp_path):
    own = os.environ | {"PYTHONPATH": str(REPOSITORY / "packaging")}
    command = [sys.executable, "-c", TABLE, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=own)
    before, after, *rows = done.stdout.splitlines()
    assert (before, after) == ("False", "True")
    assert rows == list(cache.kernel_rows()), "run packaging/kernel_table.py"


def compiled(module):
    """Compile a function as one of a module, and return what it computes."""
    import numba

    def double(x):
        return 2 * x

    double.__module__ = module
    return numba.njit(double)(1)


@pytest.fixture
def reported():
    """Context of a process that has compiled nothing yet."""
    from numba.core import event

    from gsrain_engine.kernels import CompilationReport

    return lambda: event.install_listener("numba:compile", CompilationReport())


def test_the_first_compilation_of_a_process_is_reported_with_a_number(tmp_path, monkeypatch, caplog, reported):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    (tmp_path / "tiles._count-1.nbi").touch()
    with reported():
        compiled("program_of_a_user")
        assert not caplog.records
        assert compiled("gsrain_engine.rain.drops") == compiled("gsrain_engine.rain.streaks") == 2
    (record,) = caplog.records
    assert str(len(cache.kernel_names()) - 1) in record.getMessage()
    assert record.levelname == "WARNING"  # shown without settings
    caplog.clear()
    with reported():  # another worker of the same command
        compiled("gsrain_engine.rain.drops")
    assert not caplog.records


def test_a_kernel_that_no_picture_needs_is_reported_by_its_module(tmp_path, monkeypatch, caplog, reported):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for name in cache.kernel_names():
        (tmp_path / f"{name}-1.nbi").touch()
    with reported():
        compiled("gsrain_engine.evaluation.lidar")
    assert "gsrain_engine.evaluation.lidar" in caplog.text


def kernel_signatures() -> set[tuple[str, str]]:
    """Names and argument types of the kernels that this process has compiled or loaded."""
    from numba.core.dispatcher import Dispatcher

    kernels = [each for each in gc.get_objects() if isinstance(each, Dispatcher)]
    return {(each.py_func.__qualname__, str(types)) for each in kernels for types in each.signatures}


def draw_lamps_behind_a_windshield() -> set[tuple[str, str]]:
    """Draw what a window shows of a wet road at night, after it has prepared its kernels; returns those it has not."""
    import numpy as np

    from gsrain_engine.editor.drawing.textures import compile_kernels
    from gsrain_engine.rain.settings import load_preset
    from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
    from gsrain_engine.render.cpu.renderer import CpuRenderer
    from gsrain_engine.render.draw import draw
    from gsrain_engine.render.frame_input import FrameInput, Quality
    from gsrain_engine.render.still_scene import StillScene
    from gsrain_engine.render.view import RenderView
    from gsrain_engine.scene.camera import Camera, look_at
    from gsrain_engine.scene.ground_water import GroundWater
    from gsrain_engine.scene.lamps import Lamp
    from night_scene import INTENSITY_M2, LANTERN_M, night_scene

    compile_kernels()
    before = kernel_signatures()
    water = GroundWater((-12.0, -12.0), 1.0, np.frombuffer(bytes([255]) * 24 * 24 * 2, np.uint8).reshape(24, 24, 2))
    scene = replace(night_scene(), water=water, lamps=(Lamp(position=tuple(LANTERN_M), intensity_m2=INTENSITY_M2),))
    pose = look_at(np.array([0.0, -8.0, 1.5]), np.array([0.0, 9.0, 2.0]), np.array([0.0, 0.0, 1.0]))
    view, rainfall = RenderView(Camera.from_fov(192, 128, 60.0, pose), 3.0), RainSimulation.start(load_preset("demo"))
    renderer = CpuRenderer()
    for still in (None, StillScene()):
        draw(renderer, FrameInput.of(scene, rainfall, OVERCAST, view, Quality(still=still))).read_uint8()
    return kernel_signatures() - before


def test_all_kernels_of_a_window_are_prepared_at_once():
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as other:
        assert other.submit(draw_lamps_behind_a_windshield).result() == set()


EVAPORATION, SPLIT = (
    next(row for row in cache.kernel_rows() if row.startswith(name))
    for name in ("water.films._evaporation(", "rain.drop_field._split(")
)


def python(code: str, folder: Path, **options) -> subprocess.Popen[str]:
    """Start a process whose kernels are in a folder."""
    own = os.environ | {"NUMBA_CACHE_DIR": str(folder)}
    return subprocess.Popen([sys.executable, "-c", code], env=own, text=True, stdout=subprocess.PIPE, **options)


HELPER = """
from gsrain_engine import kernel_helpers

kernel_helpers.kernel_rows = lambda: {rows}
kernel_helpers.compile_table()
"""


def test_a_helper_compiles_the_kernels_of_the_table_that_nobody_compiles(tmp_path):
    def compiled() -> list[str]:
        with python(HELPER.format(rows=(EVAPORATION, SPLIT)), tmp_path) as helper:
            assert helper.wait() == 0
        return sorted(each.name.partition("-")[0] for each in tmp_path.rglob("*.nbi"))

    with python(HOLDER, tmp_path, stdin=subprocess.PIPE) as other:
        assert other.stdout.readline() == "holds\n"
        assert compiled() == ["drop_field._split"]
        other.communicate("end\n")
    assert compiled() == ["drop_field._split", "films._evaporation"]


HOLDER = """
from gsrain_engine.water import films

films._evaporation._cache.lock(waiting=False)
print("holds", flush=True)
if input() == "compile":
    films._evaporation(20.0)
"""

WAITER = """
from gsrain_engine import kernel_helpers, kernels
from gsrain_engine.water import films
from numba.core import event

kernel_helpers.kernel_rows = lambda: {rows}
lock, compiled = kernels.KernelCache.lock, event.RecordingListener()

def note(cache, *, waiting):
    if waiting:
        print("waits", flush=True)
    return lock(cache, waiting=waiting)

kernels.KernelCache.lock = note
with event.install_listener("numba:compile", compiled):
    films._evaporation(20.0)
print(sum(each.data["dispatcher"] is films._evaporation for _, each in compiled.buffer))
"""


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
@pytest.mark.parametrize(("end", "count"), [("compile", 0), ("end", 2)])  # a start and an end of compiling
def test_a_kernel_is_compiled_by_one_process_while_others_compile_the_next(tmp_path, end, count):
    with python(HOLDER, tmp_path, stdin=subprocess.PIPE) as holder:
        assert holder.stdout.readline() == "holds\n"
        with python(WAITER.format(rows=(EVAPORATION, SPLIT)), tmp_path) as waiter:
            assert waiter.stdout.readline() == "waits\n"
            assert [each.name.partition("-")[0] for each in tmp_path.rglob("*.nbi")] == ["drop_field._split"]
            holder.communicate(f"{end}\n")
            assert int(waiter.stdout.read()) == count


def helpers_now() -> list[psutil.Process]:
    return [each for each in psutil.Process().children() if "gsrain_engine.kernel_helpers" in each.cmdline()]


def test_helpers_take_all_cores_and_end_when_they_are_told(tmp_path, monkeypatch):
    from gsrain_engine import kernel_helpers

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(kernel_helpers, "usable_cores", lambda: 2)
    helpers = kernel_helpers.KernelHelpers()
    assert len(helpers_now()) == 2 and helpers.are_running
    helpers.end()
    assert helpers_now() == [] and not helpers.are_running
    assert not kernel_helpers.KernelHelpers(spare_cores=2).are_running


STARTER = """
from gsrain_engine.kernel_helpers import KernelHelpers

helpers = KernelHelpers()
print("started", flush=True)
input()
"""


def test_helpers_end_with_a_process_that_is_killed(tmp_path):
    with python(STARTER, tmp_path, stdin=subprocess.PIPE) as starter:
        assert starter.stdout.readline() == "started\n"
        helpers = psutil.Process(starter.pid).children()
        starter.kill()
    assert helpers
    _, alive = psutil.wait_procs(helpers, 30)
    assert alive == []


class Ended:
    """Helpers that end while they are looked at."""

    def __init__(self):
        self.states = iter([True, False])

    @property
    def are_running(self):
        return next(self.states)


def test_a_window_counts_while_helpers_compile(tmp_path, monkeypatch):
    from gsrain_engine.editor.drawing import textures

    calls = list[str]()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(textures, "KernelHelpers", lambda: calls.append("helpers") or Ended())
    monkeypatch.setattr(textures, "compile_kernels", lambda: calls.append("here"))
    textures.load_kernels(lambda count: calls.append(str(count)))
    mark_kernels()
    textures.load_kernels()
    assert calls == ["helpers", "0", "here", "here"]


@pytest.fixture
def own_places(tmp_path, monkeypatch):
    """Cache and temporary files of this test alone."""
    for name in ("cache", "tmp"):
        (tmp_path / name).mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(cache.tempfile, "tempdir", str(tmp_path / "tmp"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "set back in the end")
    return tmp_path


def chosen():
    os.environ.pop("NUMBA_CACHE_DIR", None)
    use_kernel_cache()
    return Path(os.environ["NUMBA_CACHE_DIR"])


@pytest.mark.skipif(sys.platform != "linux", reason="places as Linux has them")
def test_full_disks_lead_to_temporary_files_of_this_user_alone(own_places, monkeypatch):
    default = chosen()
    assert default.is_relative_to(own_places / "cache")
    monkeypatch.setattr(cache, "ROOM_BYTES", 1 << 62)
    other = chosen()
    assert other.is_relative_to(own_places / "tmp")
    assert other.parent.stat().st_mode & 0o077 == 0
    (default / "kernel.nbi").write_bytes(b"index.")
    assert chosen() == default  # existing kernels need no room
    (default / "kernel.nbi").unlink()
    other.parent.chmod(0o777)  # Numba would run files that others put there
    assert chosen() == default


@pytest.mark.skipif(sys.platform != "linux", reason="places as Linux has them")
@pytest.mark.parametrize("torn", [b"", b"\x80\x04half"])
def test_truncated_kernels_are_removed(own_places, torn):
    folder = chosen() / "raster_12"
    folder.mkdir()
    for name, data in {"whole.nbi": b"\x80\x04N.", "torn.nbi": torn, "torn.1.nbc": torn, "notes.txt": b""}.items():
        (folder / name).write_bytes(data)
    mark_kernels()
    chosen()
    assert sorted(each.name for each in folder.iterdir()) == ["notes.txt", "whole.nbi"]
    assert not has_kernels()
