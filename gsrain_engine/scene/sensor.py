"""Image sensor and lens of a camera, and their presets."""

from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float64
from msgspec import Meta

from ..presets import load_config, shipped_config_names
from ..settings import Settings
from .camera import Camera
from .rolling_shutter import Readout, readout_of

DEFAULT_SENSOR = "automotive"


class ThinLens(NamedTuple):
    """Thin lens of a camera, in meters; an opening of 0 is a pinhole."""

    aperture_m: float = 0.0
    """Diameter of the opening."""
    focus_m: float = 10.0
    """Distance that is sharp."""

    def circle_of_confusion_m(self, depth_m: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Circle of confusion of a thin lens, as a diameter at a depth: A |1 - d / d_focus|.

        In the image it is c = f A |1/d - 1/d_focus| px, with f in px.
        """
        return self.aperture_m * np.abs(1 - depth_m / self.focus_m)


PINHOLE = ThinLens()


class Sensor(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Image sensor and lens of a camera. The defaults are a pinhole that adds nothing to the picture."""

    # fmt: off
    size_px: Annotated[tuple[Annotated[int, Meta(ge=16, le=65_536)], Annotated[int, Meta(ge=16, le=65_536)]], Meta(
        title="Size", extra={"unit": "px"},
        description="Native width and height. A smaller picture shows all of its height.")] = (1920, 1280)
    pixel_pitch_um: Annotated[float, Meta(
        ge=0.5, le=50, title="Pixel pitch", extra={"unit": "um"}, description="Distance of native pixels.")] = 3.0
    f_number: Annotated[Annotated[float, Meta(ge=0.7, le=64)] | None, Meta(
        title="f-number", extra={"none": "pinhole"},
        description="Focal length over the diameter of the lens opening; none is a pinhole.")] = None
    focus_distance_m: Annotated[Annotated[float, Meta(ge=0.2, le=10_000)] | None, Meta(
        title="Focus distance", extra={"unit": "m", "none": "hyperfocal"},
        description="Distance that is sharp; none is hyperfocal: infinity blurs over one native pixel.")] = None
    shutter_s: Annotated[Annotated[float, Meta(ge=1e-5, le=1)] | None, Meta(
        title="Shutter", extra={"unit": "s", "none": "the camera's"},
        description="Exposure time; none takes the camera's own.")] = None
    readout_s: Annotated[float, Meta(
        ge=0, le=0.2, title="Readout", extra={"unit": "s"},
        description="Rolling shutter: time from the first to the last row for drops; 0 is a global shutter.")] = 0.0
    readout_direction: Annotated[Literal["down", "up", "right", "left"], Meta(
        title="Readout direction", description="Course of the rolling shutter over the picture.")] = "down"
    mean_gray: Annotated[Annotated[float, Meta(ge=1, le=254)] | None, Meta(
        title="Auto exposure", extra={"none": "off"},
        description="Gray level of the mean luminance, to which a gain of 1/4 to 4 leads; none: no gain.")] = None
    full_well_e: Annotated[Annotated[float, Meta(ge=10, le=1e7)] | None, Meta(
        title="Full well", extra={"unit": "e-", "none": "no noise"},
        description="Electrons of white at gain 1; none: no noise.")] = None
    read_noise_e: Annotated[float, Meta(
        ge=0, le=1000, title="Read noise", extra={"unit": "e-"}, description="Standard deviation.")] = 0.0
    gain: Annotated[float, Meta(
        ge=1, le=256, title="Gain", description="ISO gain: white has so many times fewer electrons.")] = 1.0
    tone_curve: Annotated[Literal["srgb", "crushed"], Meta(
        title="Tone curve", description="srgb, or one with crushed blacks (docs/physics/streaks.md).")] = "srgb"
    demosaic_px: Annotated[float, Meta(
        ge=0, le=4, title="Demosaicing", extra={"unit": "px"},
        description="Blur by interpolation of the color filter array (standard deviation); 0: none.")] = 0.0
    noise_reduction: Annotated[float, Meta(
        ge=0, le=16, title="Noise reduction",
        description="Local variance that the camera smooths, in multiples of the noise's; 0: none.")] = 0.0
    noise_reduction_px: Annotated[float, Meta(
        ge=0.3, le=8, title="Reach of the noise reduction", extra={"unit": "px"},
        description="Standard deviation of its window.")] = 1.2
    sharpening: Annotated[float, Meta(
        ge=0, le=4, title="Sharpening", description="Amount of an unsharp mask of 1 px; 0: none.")] = 0.0
    chroma_noise: Annotated[float, Meta(
        ge=0, le=8, title="Chroma noise",
        description="Factor on the noise of color differences, which the correction of colors amplifies.")] = 1.0
    chroma_blur_px: Annotated[tuple[Annotated[float, Meta(ge=0, le=8)], Annotated[float, Meta(ge=0, le=8)]], Meta(
        title="Chroma blur", extra={"unit": "px"},
        description="Blur of color differences across and down the picture (standard deviation).")] = (0.0, 0.0)
    jpeg_quality: Annotated[Annotated[int, Meta(ge=1, le=100)] | None, Meta(
        title="JPEG quality", extra={"none": "no JPEG"},
        description="Compression inside of the camera, before the picture is stored; none: none.")] = None
    # fmt: on

    @property
    def changes_picture(self) -> bool:
        """True if the sensor acts on the picture itself, and not only on drops."""
        plain = self.mean_gray is None and self.full_well_e is None and self.jpeg_quality is None
        return not plain or self.tone_curve != "srgb" or self.processes_signal

    @property
    def processes_signal(self) -> bool:
        """True if noise reduction or sharpening acts on the picture."""
        filters = max(self.demosaic_px, self.noise_reduction, self.sharpening, *self.chroma_blur_px)
        return filters > 0 or self.chroma_noise != 1

    def lens(self, camera: Camera) -> ThinLens:
        """Lens with which a camera has this sensor.

        The opening A = f p / N has f and the pixel pitch p in native pixels; f is that of the picture times the ratio
        of heights, since `Camera.resized` keeps the vertical field of view: A is the same at any size of the picture.
        The hyperfocal distance is A f: there the circle of confusion at infinity is one native pixel.
        """
        if self.f_number is None:
            return PINHOLE
        focal_px = camera.fy * self.size_px[1] / camera.height
        aperture_m = focal_px * 1e-6 * self.pixel_pitch_um / self.f_number
        return ThinLens(aperture_m, self.focus_distance_m or aperture_m * focal_px)

    def readout(self, camera: Camera) -> Readout:
        """Rolling shutter in coordinates of a camera; the middle of the picture is exposed at the frame's time."""
        return readout_of(camera, self.readout_s, self.readout_direction)


# Presets
# YAML files with the fields of `Sensor`; omitted fields have their defaults.

_FOLDER = "sensors"


def load_sensor(name: str | Path) -> Sensor:
    """Load a shipped sensor by name, or a sensor file by path.

    Raises `ValueError` with the file, the field and the allowed range.
    """
    return load_config(_FOLDER, name, Sensor, "sensor")


def sensor_names() -> list[str]:
    return shipped_config_names(_FOLDER)
