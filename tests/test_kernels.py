"""Kernels whose work threads share."""

import multiprocessing
import os
import subprocess
import sys
from pathlib import Path
from threading import Event
from typing import no_type_check

import numpy as np
import pytest
from jaxtyping import Float64

from gsrain_engine.kernels import kernel, range_of
from gsrain_engine.threads import limited_kernels, results_in_order


@kernel(parallel=True)
@no_type_check
def add_one(portion, values, end):
    for i in range_of(portion, len(values)):
        if i == end:
            raise ValueError("no further")
        values[i] += 1


def counted(threads: int, length: int, end: int = -1) -> Float64[np.ndarray, " n"]:
    values = np.zeros(length)
    with limited_kernels(threads):
        add_one(values, end)
    return values


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("length", [0, 1, 7, 1000])
def test_each_item_is_worked_on_once(threads, length):
    assert (counted(threads, length) == 1).all()


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_of_a_portion_reaches_the_caller(threads):
    with pytest.raises(ValueError, match="no further"):
        counted(threads, 100, end=57)


def test_callers_in_several_threads_share_the_helpers():
    calls = ((k, lambda k=k: counted(3, 1000 + k).sum()) for k in range(40))
    assert list(results_in_order(calls, 4)) == [(k, 1000 + k) for k in range(40)]


def test_a_caller_does_not_wait_for_helpers_that_are_busy():
    from gsrain_engine import kernels

    may_end = Event()
    busy = [kernels.helpers().submit(may_end.wait, 60) for _ in range(200)]
    try:
        assert (counted(2, 100) == 1).all()
    finally:
        may_end.set()
    assert all(each.result() for each in busy)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_processes_that_are_forked_after_a_kernel_use_kernels():
    assert counted(2, 100).sum() == 100
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply_async(counted, (2, 1000)).get(60).sum() == 1000


ENDING = """
import sys, threading
import numpy as np
from test_kernels import add_one
from gsrain_engine.threads import limited_kernels

def late():
    threading.main_thread().join()  # returns as the interpreter ends, with its thread pools already closed
    values = np.zeros(8)
    with limited_kernels(3):
        add_one(values, -1)
    sys.stdout.write(f"{values.sum():.0f}")

threading.Thread(target=late).start()
"""


def test_a_kernel_is_run_to_its_end_while_the_program_ends():
    folder = Path(__file__).parent
    environ = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(folder.parent)])}
    ended = subprocess.run([sys.executable, "-c", ENDING], env=environ, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (0, "8"), ended.stderr
