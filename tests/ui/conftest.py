"""Fixtures of the tests of the window; a test that takes `driver` runs in its open window."""

import inspect

import pytest


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem):
    given = {name: pyfuncitem.funcargs[name] for name in inspect.signature(pyfuncitem.function).parameters}
    if "driver" not in given:
        return None
    given["driver"].run(lambda: pyfuncitem.obj(**given))
    return True


@pytest.fixture(autouse=True)
def _default_preferences(tmp_path, monkeypatch):
    """Give each test the default preferences, not those that the window of another one has stored."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture
def unopened(tmp_path):
    """A window with the small scene, for the test to open; its pictures are saved in a folder of their own."""
    from window_driver import Driver  # skips where no window can open

    (tmp_path / "shots").mkdir()
    return Driver(tmp_path / "shots")


@pytest.fixture
def driver(unopened):
    """A window in which the test runs."""
    return unopened
