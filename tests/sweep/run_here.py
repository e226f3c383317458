"""Runs a sweep in a process of its own, and says each step: python run_here.py SWEEP.yaml FOLDER WORKERS."""

import sys
from pathlib import Path

from gsrain_engine.sweep.executors import LocalPool
from gsrain_engine.sweep.expansion import jobs_of
from gsrain_engine.sweep.results import SweepFolder
from gsrain_engine.sweep.run import run_sweep
from gsrain_engine.sweep.settings import load_sweep

if __name__ == "__main__":
    folder = SweepFolder(Path(sys.argv[2]))
    for step in run_sweep(jobs_of(load_sweep(sys.argv[1])), LocalPool(int(sys.argv[3])), folder):
        print(step.message, flush=True)
