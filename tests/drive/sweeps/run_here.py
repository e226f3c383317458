"""Runs a sweep in a process of its own, and says each step: python run_here.py SWEEP.yaml FOLDER WORKERS."""

import sys
from pathlib import Path

from gsrain_engine.drive.sweeps.expansion import jobs_of
from gsrain_engine.drive.sweeps.local_pool import LocalPool
from gsrain_engine.drive.sweeps.run import run_sweep
from gsrain_engine.drive.sweeps.sweep import load_sweep
from gsrain_engine.drive.sweeps.sweep_folder import SweepFolder

if __name__ == "__main__":
    folder = SweepFolder(Path(sys.argv[2]))
    for step in run_sweep(jobs_of(load_sweep(sys.argv[1])), LocalPool(int(sys.argv[3])), folder):
        print(step.message, flush=True)
