"""Machines that lack a working directory, libraries, a display, a locale or a reader; and what a start loads."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from app.main import BAD_INPUT, NOBODY_READS, run
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene

REPOSITORY = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="other systems take other names")


def test_a_removed_working_directory_is_reported(tmp_path, monkeypatch, capsys):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    for line in (["info", "street"], ["street", "out"], ["render", "street", "-o", "a.png"], []):
        assert run(line) == BAD_INPUT
        (error,) = capsys.readouterr().err.splitlines()
        assert "working directory" in error
    assert run(["--help"]) == 0
    monkeypatch.chdir(tmp_path)


def started(before: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
    """Start the program as its script does, after some statements."""
    program = f"import sys, signal, resource\n{before}\nfrom app.__main__ import main\nmain()"
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)


INTERRUPTED_IMPORT = """
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            sys.meta_path.remove(self)
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Finder())
"""


@pytest.mark.parametrize("name", ["app.main", "cyclopts", "gsrain_engine"])
def test_ctrl_c_while_libraries_load_is_one_line(name):
    ended = started(INTERRUPTED_IMPORT.format(name=name), "--version")
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "gsrain: stopped\n")


@pytest.mark.parametrize("size_mib", [300, 800, 2047])
def test_too_little_address_space_is_one_sentence(size_mib):
    limit = size_mib << 20
    ended = started(f"resource.setrlimit(resource.RLIMIT_AS, ({limit}, {limit}))", "info", "street")
    assert ended.returncode == BAD_INPUT and ended.stdout == ""
    (line,) = ended.stderr.splitlines()
    assert f"{size_mib} MiB" in line and "2048 MiB" in line and "ulimit -v" in line


def test_a_library_that_can_t_be_loaded_is_one_sentence(monkeypatch, capsys):
    missing = "libGL.so.1: cannot open shared object file"
    monkeypatch.setattr("gsrain_engine.scene.open.load_scene", lambda name: (_ for _ in ()).throw(ImportError(missing)))
    assert run(["info", "street"]) == BAD_INPUT
    (error,) = capsys.readouterr().err.splitlines()
    assert missing in error and "gsrain doctor" in error


def test_files_of_any_name_are_written_where_the_locale_has_no_letters_for_them(tmp_path):
    program = """
import os, sys
from pathlib import Path
from app.main import run
from gsrain_engine.safe_io.files import whole_file
from gsrain_engine.safe_io.file_names import name_problem, shortened
assert sys.getfilesystemencoding() == "ascii", sys.getfilesystemencoding()
path = Path(sys.argv[1])
with whole_file(path) as beside:
    beside.write_text("whole")
assert name_problem(path) is None
assert "lacks" in name_problem(Path("\\u96e8"))
Path(shortened("\\u96e8" * 200)).name.encode()
raise SystemExit(run(["info", str(path)]))
"""
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONPATH": str(REPOSITORY)}
    command = [sys.executable, "-c", program, os.fspath(tmp_path / "Straße é.ply")]
    done = subprocess.run(command, capture_output=True, check=False, env=os.environ | locale)
    assert (tmp_path / "Straße é.ply").read_text() == "whole"
    assert done.returncode == BAD_INPUT
    assert done.stderr.startswith(b"gsrain: ") and b"UnicodeEncodeError" not in done.stderr
    assert list(tmp_path.iterdir()) == [tmp_path / "Straße é.ply"]


def test_a_display_that_can_not_be_opened(monkeypatch, capsys):
    environment = os.environ | {"DISPLAY": ":99999", "PYTHONPATH": str(REPOSITORY)}
    environment.pop("WAYLAND_DISPLAY", None)
    command = [sys.executable, "-m", "app"]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == BAD_INPUT
    assert ended.stderr.strip().startswith("gsrain: the display can't be opened")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert run([]) == BAD_INPUT
    assert "no display" in capsys.readouterr().err


def test_output_that_nobody_reads_ends_without_a_word():
    program = """
import sys
from app.main import run
import gsrain_engine.scene.open as scenes
def talk(name):
    for _ in range(100_000):
        print("street")
scenes.load_scene = talk
raise SystemExit(run(["info", "street"]))
"""
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=REPOSITORY
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == b"street\n"
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(60) == NOBODY_READS


SCIPY_PARTS = ("interpolate", "ndimage", "optimize", "spatial", "stats")
SLOW = ("matplotlib", "onnxruntime", "torch", "xarray", *(f"scipy.{part}" for part in SCIPY_PARTS))


@pytest.mark.parametrize(
    ("modules", "slow"),
    [
        ("app.main", ("numpy", "numba", "gsrain_engine.scene.scene")),
        ("ui.window", ("scipy", "numba")),
        ("ui.workspace, app.render, app.drive, app.scene, app.evaluate.images", SLOW),
    ],
)
def test_a_start_does_not_load_what_it_may_never_need(modules, slow):
    code = f"import sys, {modules}; print(*(name for name in {slow!r} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    assert done.stdout.strip() == ""


POSIX_ONLY = re.compile(r"^(import|from) (fcntl|grp|posix|pty|pwd|resource|syslog|termios|tty)\b", re.MULTILINE)


def test_modules_that_only_posix_has_are_imported_where_they_are_used():
    files = [
        each
        for name in ("app", "ui", "gsrain", "gsrain_engine", "gsrain_extras")
        for each in (REPOSITORY / name).rglob("*.py")
    ]
    assert [each.name for each in files if POSIX_ONLY.search(each.read_text("utf-8"))] == []


def test_commands_run_without_what_only_posix_has_and_without_the_libraries_of_the_window(tmp_path):
    program = """
import os, select, signal, subprocess, sys, types
import av, cv2, moderngl, multiprocessing.spawn, numba, PIL.Image, platformdirs, psutil, rich.progress

class Absent:
    def find_spec(name, path=None, target=None):
        if name in absent:
            raise ModuleNotFoundError(name)

absent = {"fcntl", "resource", "pwd", "grp", "termios", "imgui_bundle", "glfw", "pyrender"}
sys.meta_path.insert(0, Absent)
for name in absent & set(sys.modules):
    del sys.modules[name]
sys.modules["msvcrt"] = types.SimpleNamespace(LK_LOCK=1, LK_NBLCK=2, locking=lambda handle, mode, count: None)
for module, names in {
    os: "fork getuid geteuid killpg mkfifo nice sched_getaffinity setsid uname O_DIRECTORY O_NOFOLLOW O_NONBLOCK",
    signal: "SIGCONT SIGHUP SIGKILL SIGPIPE SIGSTOP SIGUSR1 alarm",
    select: "poll",
}.items():
    for name in names.split():
        delattr(module, name)
from app.main import run
print([run(line.split()) for line in sys.argv[1:]])
"""
    write_scene(small_scene(), tmp_path / "small")
    lines = (
        "info small",
        "convert small a.spz",
        "render small --rain 8.5 --size 48x32 --backend cpu -o a.mp4 --duration 0.1",
    )
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    command = [sys.executable, "-c", program, *lines]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, env=environment)
    assert done.stdout.splitlines()[-1:] == ["[0, 0, 0]"], done.stderr
