"""Fixtures of the tests of the window."""

import pytest


@pytest.fixture(autouse=True)
def _default_preferences(tmp_path, monkeypatch):
    """Give each test the default preferences, not those that the window of another one has stored."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture
def driver(tmp_path):
    """A window with the small scene; its pictures are saved in a folder of their own."""
    from window_driver import Driver  # skips where no window can open

    (tmp_path / "shots").mkdir()
    return Driver(tmp_path / "shots")
