"""Camera paths as they stand in `scene.json`."""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from ..camera import DEFAULT_EXPOSURE_S
from ..paths.camera_path import CameraPath
from ..paths.curves import Interpolation
from ..paths.easing import Easing
from .track_record import Quaternion, Vector, unit_quaternions


class KeyRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One keyframe; position in scene units and axes, camera axes as OpenCV's."""

    time_s: float
    position: Vector
    quaternion_wxyz: Quaternion
    vertical_fov_deg: Annotated[float, Meta(gt=0, lt=180)]


class PathRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `CameraPath`."""

    keyframes: Annotated[list[KeyRecord], Meta(min_length=1)]
    exposure_s: Annotated[float, Meta(gt=0)] = DEFAULT_EXPOSURE_S
    interpolation: Interpolation = "spline"
    easing: Easing = "none"
    loop: bool = False
    is_timed: bool = True


def path_record(path: CameraPath) -> PathRecord:
    columns = (path.times_s, path.positions, path.quaternions_wxyz, path.vertical_fov_deg)
    return PathRecord(
        keyframes=[
            KeyRecord(time_s=t, position=(x, y, z), quaternion_wxyz=(qw, qx, qy, qz), vertical_fov_deg=fov)
            for t, (x, y, z), (qw, qx, qy, qz), fov in zip(*(each.tolist() for each in columns), strict=True)
        ],
        exposure_s=path.exposure_s,
        interpolation=path.interpolation,
        easing=path.easing,
        loop=path.loop,
        is_timed=path.is_timed,
    )


def path_of(record: PathRecord, where: str) -> CameraPath:
    """Path of plain values.

    Raises:
        ValueError: Where its times do not rise or a rotation is none; `where` tells in which field it stands.
    """
    keys = record.keyframes
    times = np.array([key.time_s for key in keys], np.float64)
    if (np.diff(times) <= 0).any():
        raise ValueError(f"times must rise - at {where}")
    return CameraPath(
        times,
        np.array([key.position for key in keys], np.float64).reshape(-1, 3),
        unit_quaternions([key.quaternion_wxyz for key in keys], where),
        np.array([key.vertical_fov_deg for key in keys], np.float64),
        record.exposure_s,
        record.interpolation,
        record.easing,
        record.loop,
        record.is_timed,
    )
