"""The job "Reconstruct" in a process that ends while it trains."""

import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from gsrain_engine.datasets.capture_folder import write_views
from small_capture import small_capture

pytest.importorskip("torch")


def test_a_program_that_ends_while_it_trains_leaves_no_worker_no_file_and_no_warning(tmp_path):
    for _ in write_views(tmp_path / "drive", small_capture()):
        pass
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    own = {"TMPDIR": str(temporary), "XDG_DATA_HOME": str(tmp_path / "data"), "XDG_CONFIG_HOME": str(tmp_path / "set")}
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name("session_that_closes.py"), tmp_path / "drive"],
        env=os.environ | own, capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    assert done.stderr == ""  # such as that of shared memory that was leaked
    assert not psutil.pid_exists(int(done.stdout))
    assert not list(temporary.iterdir())
