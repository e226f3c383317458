"""Kill -9 at every call of a save: there is always the old scene or the new one, and nothing piles up."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.skipif(os.name != "posix", reason="needs fork")
def test_a_save_that_is_killed_leaves_a_whole_scene_and_no_litter(tmp_path: Path) -> None:
    program = Path(__file__).with_name("killed_saves.py")
    run = subprocess.run([sys.executable, program, tmp_path / "scene"], capture_output=True, text=True, check=True)
    *faults, last = run.stdout.splitlines()
    assert faults == []
    assert int(last.split()[0]) > 50
