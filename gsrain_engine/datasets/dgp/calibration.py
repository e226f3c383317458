"""Calibrations of DGP: where the sensors of a vehicle sit, and how its cameras see.

Facts: CameraIntrinsics in dgp/proto/geometry.proto of github.com/TRI-ML/dgp, which copies OpenCV's coefficients.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.camera import Camera

from ..capture import CaptureError, Lens
from ..files.json_file import read_json_object
from ..files.reading_errors import WRONG_VALUES, what_is_wrong
from ..geometry.opencv_camera import opencv_camera
from ..geometry.rigid_poses import named_pose


@dataclass(frozen=True, slots=True, eq=False)
class DgpSensor:
    """A row of a calibration: where a sensor sits, and how a camera sees."""

    to_vehicle: Float64[np.ndarray, "4 4"]
    intrinsics: dict[str, Any]

    def camera(self, width: int, height: int, world_to_camera: Float64[np.ndarray, "4 4"]) -> Camera:
        """Camera of a picture; ValueError for calibrations that are none, or skewed."""
        fx, fy, cx, cy, skew = (float(self.intrinsics.get(name, 0.0)) for name in ("fx", "fy", "cx", "cy", "skew"))
        if abs(skew) > 0.5:
            raise ValueError(f"its calibration has a skew of {skew:g} px, and cameras here have none")
        return opencv_camera((fx, fy), (cx, cy), (width, height), world_to_camera)

    def lens_distortion(self) -> Lens | None:
        """What the calibration says beyond a pinhole; ValueError for models that OpenCV does not have."""
        value = {name: float(number) for name, number in self.intrinsics.items()}
        strange = [name for name in ("alpha", "beta", "w", "xi", "equirectangular", "taux", "tauy") if value.get(name)]
        if strange:
            raise ValueError(f"its lens model ({', '.join(strange)} in the calibration) is not known here")
        if value.get("fisheye", 0.0) not in (0.0, 1.0):
            raise ValueError(f"its fisheye model {value['fisheye']:g} is not known here")
        if value.get("fisheye"):
            return Lens("fisheye", tuple(value.get(name, 0.0) for name in ("k1", "k2", "k3", "k4")))
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
        coefficients = [value.get(name, 0.0) for name in names]
        if not any(coefficients):
            return None
        length = next(count for count in (5, 8, 12) if not any(coefficients[count:]))
        return Lens("opencv", tuple(coefficients[:length]))


def read_dgp_calibration(file: Path) -> dict[str, DgpSensor]:
    """Sensors by their names. Raises `CaptureError`."""
    values = read_json_object(file)
    try:
        rows = zip(values["names"], values["extrinsics"], values["intrinsics"], strict=True)
        return {str(name): DgpSensor(named_pose(pose), dict(lens)) for name, pose, lens in rows}
    except WRONG_VALUES as error:
        raise CaptureError(f"{file}: {what_is_wrong(error)}") from None
