"""Shows many drives in parallel: two agents, two intensities, two seeds, one table; needs pyarrow (`gsrain[drive]`).

    python examples/09_sweep.py [OUT] [SCENE]

If run again, it continues where it was stopped; after a change of settings, only new drives run. SCENE needs an ego
vehicle, as in 08.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.sweep.run import run_sweep_and_report
from gsrain_engine.sweep.settings import DriveSweep, Jitter


def main(out: Path, scene: str) -> None:
    """Run the drives and print the results."""
    sweep = DriveSweep(
        scenarios=("stationary-lead",),
        scenes=(scene,),
        agents=("constant-velocity", "oracle-idm"),
        intensities_mm_h=(0.0, 8.5),
        seeds=2,
        jitter=Jitter(ahead_m=1.0),
    )
    told = run_to_end(run_sweep_and_report(sweep, out / "sweep"), lambda step: print(step.message)).numbers
    for cell in told["cells"]:
        print(f"{cell['agent']} at {cell['intensity_mm_h']:g} mm/h: {cell['collisions']} of {cell['runs']} collide")
    for error, count in told["errors"].items():
        print(f"{count} of {told['jobs']} failed: {error}")
    print(out / "sweep" / "report.html")


if __name__ == "__main__":  # workers are separate processes that import this file too
    if find_spec("pyarrow") is None:
        print("skipped: rows of sweeps take the package pyarrow (pip install 'gsrain[drive]')")
    else:
        main(Path(sys.argv[1] if len(sys.argv) > 1 else "out"), sys.argv[2] if len(sys.argv) > 2 else "street")
