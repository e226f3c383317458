"""Fixtures of the tests of commands."""

import json

import pytest

from app.main import run


@pytest.fixture
def reported(tmp_path):
    """Run a command that succeeds; returns the numbers that --json writes."""

    def run_command(*words):
        file = tmp_path / "reported.json"
        assert run([*map(str, words), "--json", str(file)]) == 0
        return json.loads(file.read_text())

    return run_command
