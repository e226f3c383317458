"""Cameras whose picture was scaled after they were calibrated, and checks of calibrations."""

from dataclasses import replace

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.errors import SceneFormatError

from ..capture import CaptureError


def scaled_camera(camera: Camera, width: int, height: int) -> Camera:
    """The same picture stretched to another size in pixels; what is seen at its edges stays."""
    sx, sy = width / camera.width, height / camera.height
    return replace(
        camera, width=width, height=height, fx=camera.fx * sx, fy=camera.fy * sy, cx=camera.cx * sx, cy=camera.cy * sy
    )


def camera_of_picture(camera: Camera, size: tuple[int, int], picture: str) -> Camera:
    """Fit a calibration to a picture that was scaled after it; `CaptureError` where the sides' ratio differs."""
    width, height = size
    if (width, height) == (camera.width, camera.height):
        return camera
    if abs(width * camera.height - height * camera.width) > max(camera.width, camera.height):
        expected = f"{camera.width}x{camera.height}"
        raise CaptureError(
            f"{picture}: is {width}x{height} px, its camera says {expected}, which has other proportions"
        )
    return scaled_camera(camera, width, height)


def checked_camera(camera: Camera, what: str) -> Camera:
    """Return the camera; `CaptureError` for numbers that no camera has (a size of 0, a pose that is no rotation)."""
    try:
        return Camera.from_json({**camera.to_json(), "exposure_s": camera.exposure_s}, what)
    except SceneFormatError as error:
        raise CaptureError(str(error)) from None
