"""Entry point of the group `gsrain.drive_exports`: `gsrain drive --export xosc`."""

from pathlib import Path

import msgspec

from gsrain_engine.simulation.drive_exports import DriveExport, FinishedDrive
from gsrain_engine.simulation.scenario import Scenario


def _export(drive: FinishedDrive, path: Path) -> None:
    from .writer import write_openscenario  # needs an optional package

    write_openscenario(path, msgspec.convert(drive.rollout.scenario, Scenario), drive.scene)


EXPORT = DriveExport((".xosc", ".xodr"), _export, packages=("scenariogeneration",))
