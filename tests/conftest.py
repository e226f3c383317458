"""Fixtures that many tests share."""

import gc
import json
import os
import re
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

import type_checker
from repository import REPOSITORY

type_checker.check_first_calls()

# Machines are noisy: no example fails for being slow. Where CI is set every run tries the same examples.
settings.register_profile(
    "gsrain", deadline=None, derandomize=bool(os.environ.get("CI")), suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("gsrain")

# Modules compiled once are kept, whatever the machine's setting: else each command, worker and window that a test
# starts compiles all of them anew, those of torch and SciPy as well.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# What tests prefer, keep and have opened is nobody's own.
_OWN = tempfile.TemporaryDirectory(prefix="gsrain-tests-")
os.environ["XDG_STATE_HOME"] = os.environ["XDG_CONFIG_HOME"] = _OWN.name

# No test cuts the power: that files reach the disk itself takes their writers' time alone.
os.fsync = lambda file: None

# Two test processes share two cores: threads of torch would only wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("LP_NUM_THREADS", "0")  # Mesa's llvmpipe

# Garbage is looked for less often, and not among what collecting tests has loaded: two million objects, which all stay.
gc.set_threshold(20_000)


# Folders with the files that take longest; with these first, two processes end at about the same time.
_LONGEST = ("ui", "test_", "python_api", "sweep", "evaluation", "recolor", "appearance", "training", "water", "render")


def pytest_collection_modifyitems(items):
    def rank(item):
        return next((i for i, each in enumerate(_LONGEST) if item.nodeid.startswith(f"tests/{each}")), len(_LONGEST))

    items.sort(key=rank)


def pytest_collection_finish():
    gc.freeze()


@pytest.fixture(scope="module", autouse=True)
def _return_memory():
    """Return what a file's tests have freed: else the C library keeps gigabytes for the next ones."""
    yield
    from gsrain_engine.malloc_tuning import trim_memory  # after the type checker

    trim_memory()


def _has_street() -> bool:
    from gsrain_engine.scene.built_in import DEFAULT_SCENE, built_in_names  # after the type checker

    return DEFAULT_SCENE in built_in_names()


def pytest_runtest_setup(item):
    parameters = item.callspec.params.values() if hasattr(item, "callspec") else ()
    is_of_street = any(str(each).startswith("street") for each in parameters)  # its command, or its scenes
    if (is_of_street or item.get_closest_marker("street")) and not _has_street():
        pytest.skip(_NEEDS_STREET)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Skip tests that fail because nothing has the name of the street or of its models, where these were deleted."""
    report = yield
    if report.failed and _MISSES_STREET.search(f"{report.longreprtext}{report.capstderr}") and not _has_street():
        report.outcome = "skipped"
        report.longrepr = (str(item.path), item.location[1], _NEEDS_STREET)
    return report


_NEEDS_STREET = "needs the built-in street"
_MISSES_STREET = re.compile(r"no built-in scene has|model \S+: no such file|street(:\w+)?: (there is )?no ")

_MAX_SKIPS = {
    r"needs an? (NVIDIA )?GPU": 20,
    r"no (test data|reference images|detector) at": 10_000,
    r"weights": 5,
    r"needs the built-in street|its folder was deleted": 10_000,
    r"libOSMesa is not installed": 1,  # Debian 13 has none
}
"""Reasons to skip tests of the whole suite, and how many may be; packages that tests need are installed with them."""


def pytest_sessionfinish(session):
    """Fail a run of the whole suite that skips more than `_MAX_SKIPS`: skipped tests would otherwise go unnoticed."""
    config = session.config
    is_whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS and not (
        config.option.keyword or config.option.markexpr
    )
    if not is_whole or hasattr(config, "workerinput") or config.option.collectonly:
        return
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    left = dict(_MAX_SKIPS)
    for report in reporter.stats.get("skipped", []):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        known = next((each for each in left if re.search(each, reason)), None)
        if known is not None and left[known] > 0:
            left[known] -= 1
        else:
            reporter.write_line(f"skipped without need: {report.nodeid}: {reason}", red=True)
            session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.fixture(autouse=True)
def _one_thread():
    """Use one thread for kernels where each test process has a core; tests of more threads set their number."""
    from gsrain_engine.threads import kernel_threads, limited_kernels  # after the type checker

    with limited_kernels(1 if "PYTEST_XDIST_WORKER" in os.environ else kernel_threads()):
        yield


@pytest.fixture(autouse=True)
def _begun_anew():
    type_checker.begin_test()
    Path(_OWN.name, "gsrain", "preferences.yaml").unlink(missing_ok=True)  # of the test before


@pytest.fixture
def reported(tmp_path):
    """Run a command that succeeds; returns the numbers that --json writes."""
    from app.main import run  # once the machine's settings above are made

    def run_command(*words):
        file = tmp_path / "reported.json"
        assert run([*map(str, words), "--json", str(file)]) == 0
        return json.loads(file.read_text())

    return run_command


def shared_folder() -> Path:
    """Folder of test data that is not part of the project."""
    return Path(os.environ.get("GSRAIN_TEST_DATA", REPOSITORY.parent / "shared" / "data"))


@pytest.fixture(scope="session")
def test_data() -> Path:
    """Real captures and data sets; tests that need them are skipped where they are absent."""
    folder = shared_folder()
    if not folder.is_dir():
        pytest.skip(f"no test data at {folder} (set GSRAIN_TEST_DATA)")
    return folder


@pytest.fixture(scope="session")
def golden() -> Path:
    """Reference images of an independent rasterizer."""
    folder = shared_folder().parent / "golden"
    if not folder.is_dir():
        pytest.skip(f"no reference images at {folder} (set GSRAIN_TEST_DATA)")
    return folder
