"""Sensor: exposure, noise, tone curve and JPEG of the camera that the rain names."""

from collections.abc import Callable

from ..camera_response import CameraResponse, metered_gain
from ..frame_input import FrameInput, Quality
from ..renderer import DrawnPicture, PictureFilter
from .base import FrameParts


class SensorPass:
    """Response of a sensor to the picture. A photograph has been through its own."""

    name, factor = "sensor", None

    def active(self, frame: FrameInput) -> bool:
        has_sensor = frame.simulation is not None and frame.simulation.picture_sensor is not None
        return has_sensor and frame.is_image and not frame.is_photograph

    def add(self, frame: FrameInput, parts: FrameParts) -> None:
        rainfall = frame.simulation
        assert rainfall is not None and rainfall.picture_sensor is not None
        gain = metered(frame, parts.draw)
        sensor, camera, seed = rainfall.picture_sensor, frame.view.camera, rainfall.rain.seed
        response = CameraResponse(sensor, camera, frame.time_s, seed, gain)
        parts.filters.append(PictureFilter(self.name, response.picture))


def metered(frame: FrameInput, draw: Callable[[FrameInput], DrawnPicture]) -> float:
    """Gain of automatic exposure, which is metered in the clear scene: rain does not change it. 1 without a sensor.

    It is metered once for each camera.
    """
    sensor = None if frame.simulation is None else frame.simulation.picture_sensor
    gains, camera = frame.mount.memory.gains, frame.mount.camera
    if sensor is None or sensor.mean_gray is None:
        return 1.0
    if camera not in gains:
        clear = frame.changed(is_clear=True, quality=Quality(), without={"glass", "sensor"})
        gains[camera] = metered_gain(draw(clear).read_uint8(), sensor)
    return gains[camera]
