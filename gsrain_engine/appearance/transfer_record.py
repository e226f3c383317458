"""How rainy views were made, as a file beside them."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.capture_folder import write_world
from gsrain_engine.untrusted.plain_values import json_values, read_whole
from gsrain_engine.untrusted.printable import printable

TRANSFER = "transfer.json"
_VERSION = 1
_LARGEST = 1e9
"""Of a transform: metres a unit, and metres to the origin."""


@dataclass(frozen=True, slots=True, eq=False)
class TransferRecord:
    """How rainy views were made."""

    method: str
    made_of: str
    """Name of the scene or the capture."""
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Plain values."""
    to_world: Float64[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Similarity from the units and axes of the scene or capture to the world (metres, z up)."""
    notes: tuple[str, ...] = ()
    """What the method could not do, a sentence each."""

    @property
    def metres_per_unit(self) -> float:
        """Length of a unit of the scene or capture."""
        return float(np.cbrt(np.linalg.det(self.to_world[:3, :3])))


def write_record(folder: Path, record: TransferRecord, *, has_poses: bool = True) -> None:
    """Write the record, and a file on the world where z is not up, the unit is not the metre, or poses are unknown."""
    values = {
        "version": _VERSION,
        "method": record.method,
        "made_of": record.made_of,
        "settings": dict(record.settings),
        "to_world": record.to_world.tolist(),
        "notes": list(record.notes),
    }
    (folder / TRANSFER).write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    x, y, z = (record.to_world[2, :3] / record.metres_per_unit).tolist()
    is_metric = bool(np.isclose(record.metres_per_unit, 1, atol=1e-9))
    if not is_metric or not has_poses or not np.allclose((x, y, z), (0, 0, 1), atol=1e-12):
        write_world(folder, (x, y, z), is_metric=is_metric, has_poses=has_poses)


def read_record(folder: Path) -> TransferRecord:
    """Read how rainy views were made; raises `CaptureError` where the file is missing or another one."""
    file = folder / TRANSFER
    try:
        values = json_values(read_whole(file))
        if values["version"] > _VERSION:
            raise CaptureError(
                f"{file}: version {values['version']} is newer than {_VERSION}, which this program knows"
            )
        to_world = np.array(values["to_world"], np.float64)
        is_bounded = to_world.shape == (4, 4) and bool((np.abs(to_world) <= _LARGEST).all())  # so nothing overflows
        if not is_bounded or np.linalg.det(to_world[:3, :3]) <= 0:
            raise CaptureError(f"{file}: to_world must be a similarity, 4x4 numbers within {_LARGEST:g}")
        notes = tuple(printable(str(each)) for each in list(values.get("notes", ())))
        return TransferRecord(str(values["method"]), str(values["made_of"]), dict(values["settings"]), to_world, notes)
    except (OSError, KeyError, TypeError, ValueError, OverflowError) as error:
        if isinstance(error, CaptureError):
            raise
        raise CaptureError(f"{file}: not the record of a transfer ({printable(error)})") from None
