"""Rain settings: every parameter with bounds, unit and help text, and the presets."""

import math
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from ..choices import LAMP_WORDS
from ..presets import load_config
from ..settings import Settings

Vector = tuple[float, float, float]
ExposureSeconds = Annotated[float, Meta(ge=1e-5, le=1)]
WindComponent = Annotated[float, Meta(ge=-40, le=40)]
Share = Annotated[float, Meta(ge=0, le=1)]
CALIBRATED_UP_TO_MM_H = 13.0
"""Upper end of the published calibration; higher intensities are marked as extrapolated in window and reports."""

MAX_LAMP_GAIN = 10.0
HEAVIEST_MM_H = 149.0
"""Highest intensity: the upper end of very heavy rain (ASAM OSI)."""

SMALLEST_MM, LARGEST_MM = 0.1, 8.0
"""Diameter limits: smaller drops are drizzle mist, larger ones break up. The distribution is cut and renormalized."""


class RegionBox(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Axis-aligned box in the anchor's frame (x forward, y left, z up, origin 1.5 m above the road), in meters."""

    minimum_m: Vector
    maximum_m: Vector

    def __post_init__(self) -> None:
        for low, high, axis in zip(self.minimum_m, self.maximum_m, "xyz", strict=True):
            if not (-1000 <= low < high <= 1000):
                raise ValueError(f"box needs -1000 <= minimum < maximum <= 1000 m on {axis}, got {low} and {high}")

    @property
    def size_m(self) -> Vector:
        (left, back, low), (right, front, high) = self.minimum_m, self.maximum_m
        return right - left, front - back, high - low

    @property
    def center_m(self) -> Vector:
        (left, back, low), (right, front, high) = self.minimum_m, self.maximum_m
        return (right + left) / 2, (front + back) / 2, (high + low) / 2

    @property
    def volume_m3(self) -> float:
        x, y, z = self.size_m
        return x * y * z


STREAK_REGION = RegionBox(minimum_m=(-1.0, -3.0, -1.5), maximum_m=(5.0, 3.0, 4.5))
HAZE_REGION = RegionBox(minimum_m=(-10.0, -10.0, -1.5), maximum_m=(60.0, 10.0, 20.5))


class RainSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, repr_omit_defaults=True):
    """Rain parameters. The defaults are physical; docs/physics.md gives the reason for each."""

    # fmt: off
    intensity_mm_h: Annotated[float, Meta(
        ge=0, le=HEAVIEST_MM_H, title="Intensity", extra={
            "unit": "mm/h", "option": "rain intensity", "commands": "render, disdrometer"},
        description="Rainfall intensity R; 0 is no rain. Calibrated up to 13 mm/h.")] = 0.0
    exposure_s: Annotated[ExposureSeconds | None, Meta(
        title="Exposure", extra={
            "unit": "s", "topic": "Sensor and glass", "commands": "render, drive, evaluate detection*"},
        description="Exposure time T, in which drops make streaks; without one, the sensor's, or the camera's own "
        "(4 ms by day).")] = None
    seed: Annotated[int, Meta(
        ge=0, le=2**32 - 1, title="Seed",
        extra={"group": "Wind and seed", "commands": "render, disdrometer, drive"},
        description="Same seed and time, same drops.")] = 0

    streaks: Annotated[bool, Meta(
        title="Streaks", extra={"commands": "render*"}, description="Draw near drops as streaks.")] = True
    haze: Annotated[Literal["medium", "gaussians", "none"], Meta(
        title="Haze model", extra={"commands": "render*", "negative": "none"},
        description="Far drops. medium: extinction and airlight along each ray. "
        "gaussians: the paper's. none: not drawn.")] = "medium"
    visibility_m: Annotated[Annotated[float, Meta(ge=10, le=100_000)] | None, Meta(
        title="Fog visibility", extra={
            "unit": "m", "scale": "log", "none": "no fog", "usual": 500.0,
            "topic": "Weather and road", "commands": "render, drive, evaluate detection, evaluate lidar"},
        description="Adds fog without drops, at any intensity: distance at which it leaves 5 % of a contrast "
        "(Koschmieder).")] = None
    roofs: Annotated[bool, Meta(
        title="Shelter under roofs", extra={"topic": "Weather and road", "commands": "render*"},
        description="No rain under bridges, canopies and trees.")] = False
    streak_region: Annotated[RegionBox, Meta(
        title="Streak region", extra={"group": "Regions"},
        description="Region in which drops are simulated one by one.")] = STREAK_REGION
    haze_region: Annotated[RegionBox | None, Meta(
        title="Haze region", extra={"group": "Regions"},
        description="Region of the haze; without one, everywhere, or a box of 70 m for the paper's Gaussians.")] = None

    wind_speed_m_s: Annotated[float, Meta(
        ge=0, le=60, title="Wind speed", extra={
            "unit": "m/s", "group": "Wind and seed", "slider_to": 20.0,
            "topic": "Weather and road", "commands": "render, disdrometer, drive"},
        description="Mean wind at 10 m above the ground; less below (roughness length).")] = 2.0
    wind_from_deg: Annotated[float, Meta(
        ge=0, le=360, title="Wind from", extra={
            "unit": "deg", "option": "wind-from", "group": "Wind and seed",
            "topic": "Weather and road", "commands": "render, disdrometer, drive"},
        description="Direction the wind blows from: 0 north (world y), 90 east (world x).")] = 240.0
    wind_m_s: Annotated[tuple[WindComponent, WindComponent] | None, Meta(
        title="Wind", extra={"unit": "m/s", "group": "Wind and seed"},
        description="Horizontal wind at 10 m along world x and y; sets speed and direction.")] = None
    gust_m_s: Annotated[float, Meta(
        ge=0, le=20, title="Gusts", extra={
            "unit": "m/s", "group": "Wind and seed",
            "topic": "Weather and road", "commands": "render*, disdrometer, drive*"},
        description="Amplitude of the wind's variation over seconds and meters.")] = 0.4
    turbulence_m_s: Annotated[float, Meta(
        ge=0, le=5, title="Turbulence", extra={
            "unit": "m/s", "group": "Wind and seed",
            "topic": "Weather and road", "commands": "render*, disdrometer, drive*"},
        description="RMS of the air's velocity, along each axis, in eddies that move drops one by one.")] = 0.6
    roughness_m: Annotated[float, Meta(
        ge=0.001, le=2, title="Roughness length", extra={"unit": "m", "group": "Wind and seed", "scale": "log"},
        description="Of the wind's logarithmic profile (z_0): 0.03 grass, 0.3 suburbs, 1 towns.")] = 0.3

    calibration: Annotated[str, Meta(
        title="Calibration", extra={
            "commands": "render*, disdrometer, drive, evaluate detection, evaluate lidar"},
        description="Name of a shipped calibration, or a calibration file.")] = "published"
    closure: Annotated[Literal["density", "published"], Meta(
        title="Number of drops from", extra={
            "option": "drop-density", "commands": "render*, disdrometer", "group": "Physics",
            "spelling": {"rate": "density", "flux": "density", "table": "published"},
            "titles": {"density": "rain rate", "published": "table"}},
        description="Rain rate (rate, flux, density): as many drops as the intensity needs. "
        "table (published): those of the calibration's table.")] = "density"
    diameter_scale: Annotated[float, Meta(
        ge=0.25, le=4, title="Drop size factor", extra={
            "group": "Physics", "scale": "log", "commands": "render*, disdrometer, drive*"},
        description="Multiplies all diameters. If the rain rate gives the number of drops, fewer large or more "
        "small ones give the same mm/h.")] = 1.0
    velocity: Annotated[Literal["calibration", "atlas"], Meta(
        title="Fall speed", extra={"group": "Physics"},
        description="Fall speed by diameter: the calibration's fit, or Atlas et al. (1973).")] = "calibration"

    model: Annotated[Literal["physical", "paper"], Meta(
        title="Model", extra={"option": "model", "group": "Physics"},
        description="paper: the paper's own form where it differs: streaks as of a still camera; drops are mixed as "
        "display values, fall straight and re-enter at the top; haze Gaussians jump each frame.")] = "physical"

    critical_haze_coefficient: Annotated[float, Meta(
        ge=0.1, le=50, title="Streak-to-haze factor", extra={"group": "Appearance", "scale": "log"},
        description="The paper's critical haze coefficient phi: drops farther than phi times focal length (px) times "
        "diameter are haze, nearer ones streaks.")] = 2.0
    max_copies: Annotated[int, Meta(
        ge=1, le=16, title="Gaussians a streak",
        description="n_max (eq. 10-12): at most so many Gaussians a streak.")] = 4
    haze_opacity: Annotated[float, Meta(
        ge=0.001, le=0.5, title="Haze opacity", extra={"group": "Appearance", "scale": "log"},
        description="Largest alpha of a haze Gaussian, the paper's alpha_m.")] = 0.05
    haze_sigma_m: Annotated[float, Meta(
        ge=0.05, le=5, title="Haze size", extra={"unit": "m", "group": "Appearance", "scale": "log"},
        description="Standard deviation of a haze Gaussian, the paper's s_h.")] = 0.5
    haze_count: Annotated[Annotated[int, Meta(ge=0, le=200_000)] | None, Meta(
        title="Haze Gaussians",
        description="M: none takes as many as the extinction needs, and splits them up to be smooth.")] = None
    haze_gain: Annotated[float, Meta(
        ge=0, le=50, title="Haze gain",
        extra={"unit": "x", "group": "Appearance", "slider_to": 10.0, "commands": "render*"},
        description="Multiplies the extinction; 1 is physical.")] = 1.0
    streak_gain: Annotated[float, Meta(
        ge=0, le=50, title="Streak gain",
        extra={"unit": "x", "group": "Appearance", "slider_to": 10.0, "commands": "render*"},
        description="Multiplies the streaks' opacity; 1 is physical.")] = 1.0
    sensor: Annotated[str | None, Meta(
        title="Camera model", extra={
            "group": "Camera", "topic": "Sensor and glass",
            "commands": "render, drive, evaluate detection"},
        description="Sensor and lens: automotive, pinhole, rainsense, waymo_front, or a sensor file; also sets "
        "exposure, noise, tone curve and JPEG. Without one, drops get the lens and readout of automotive.")] = None
    aperture_mm: Annotated[Annotated[float, Meta(ge=0, le=50)] | None, Meta(
        title="Aperture",
        extra={"unit": "mm", "group": "Camera", "slider_to": 10.0, "none": "the sensor's",
               "usual": 4.0, "option": "aperture", "topic": "Sensor and glass"},
        description="Diameter of the lens opening in place of the sensor's; 0 is a pinhole: all sharp.")] = None
    focus_distance_m: Annotated[Annotated[float, Meta(ge=0.2, le=10_000)] | None, Meta(
        title="Focus distance", extra={"unit": "m", "group": "Camera", "scale": "log",
                                       "none": "the sensor's", "usual": 10.0},
        description="Distance that is sharp in place of the sensor's; 10 m for an aperture of your own.")] = None
    glass: Annotated[Literal["none", "windshield", "lens"], Meta(
        title="Glass", extra={
            "group": "Glass", "topic": "Sensor and glass", "commands": "render, drive, evaluate detection"},
        description="Glass in front of the camera, on which rain lands. windshield: of cameras "
        "that look ahead. lens: of each camera.")] = "none"
    wiper: Annotated[Literal["auto", "off", "interval", "low", "high"], Meta(
        title="Wiper", extra={
            "group": "Glass", "topic": "Sensor and glass", "commands": "render*, drive*, evaluate detection*"},
        description="Wiper of the windshield; auto is a rain sensor.")] = "auto"
    glass_wet_s: Annotated[float, Meta(
        ge=0, le=600, title="Rain before start", extra={
            "unit": "s", "group": "Glass", "slider_to": 60.0,
            "topic": "Sensor and glass", "commands": "render*, drive*, evaluate detection*"},
        description="Time for which rain has landed on the glass at time 0.")] = 20.0
    glass_dirt: Annotated[float, Meta(
        ge=0, le=1, title="Dirt", extra={
            "group": "Glass", "topic": "Sensor and glass", "commands": "render*, drive*, evaluate detection*"},
        description="Dirt on the glass, which spreads light as a haze.")] = 0.1
    contact_angle_deg: Annotated[float, Meta(
        ge=15, le=90, title="Contact angle", extra={
            "unit": "deg", "option": "contact-angle", "group": "Glass",
            "topic": "Sensor and glass", "commands": "render*, drive*, evaluate detection*"},
        description="Angle between drops and glass at the rim: 30 on clean glass, 90 with water repellent.")] = 50.0
    glass_distance_m: Annotated[Annotated[float, Meta(ge=0.005, le=2)] | None, Meta(
        title="Glass distance", extra={
            "unit": "m", "group": "Glass", "scale": "log", "none": "by the kind of glass",
            "usual": 0.12, "topic": "Sensor and glass", "commands": "render*, drive*, evaluate detection*"},
        description="From the lens along its axis; without one, 0.12 m for a windshield and 0.02 m for a lens.")] = None
    drop_color: Annotated[tuple[Share, Share, Share] | None, Meta(
        title="Drop color",
        description="Display color of drops, rain and fog; without one, those of the scene's sky.")] = None

    lamps: Annotated[str | None, Meta(
        title="Light sources", extra={
            "group": "Lamps", "topic": "Weather and road", "commands": "render*, drive, evaluate detection"},
        description="Lamps that light drops and medium: none, auto (found as bright spots of a dark scene), headlights "
        "(of all vehicles, and the scene's fixed lamps), or a file. Default: the scene's own.")] = None
    lamp_gain: Annotated[float, Meta(
        ge=0, le=MAX_LAMP_GAIN, title="Lamp brightness",
        extra={"unit": "x", "group": "Lamps", "slider_to": 2.0, "topic": "Weather and road", "commands": "render*"},
        description="Multiplies the light of all lamps; 0 switches them off.")] = 1.0
    wetness: Annotated[Share | None, Meta(
        title="Wetness", extra={"topic": "Weather and road", "commands": "render*"},
        description="Share of soaked colors, 0..1; 0 is as lit; without one, it follows the rain.")] = None
    mirror: Annotated[bool, Meta(
        title="Reflections", extra={"topic": "Weather and road", "commands": "render*, drive*, evaluate detection*"},
        description="Water on the ground reflects the scene as it is, in scenes with a map of that water.")] = True
    splashes: Annotated[bool, Meta(
        title="Splashes and rings", extra={
            "topic": "Weather and road", "commands": "render*, drive*, evaluate detection*"},
        description="Drops that land throw up crowns near the camera, in scenes with wet colors, and start rings in "
        "water that mirrors.")] = True
    spray: Annotated[bool, Meta(
        title="Spray", extra={
            "topic": "Weather and road", "commands": "render*, drive*, evaluate detection*, evaluate lidar"},
        description="Fast vehicles throw water from a wet road into a wake, in scenes with wet colors.")] = True
    keep_light: Annotated[bool, Meta(
        title="Keep the light", extra={"topic": "Weather and road", "commands": "export-rain, evaluate detection*"},
        description="Keep sun and shadows of the photographs, which rain above 2.5 mm/h softens to an overcast day "
        "where distances and sky are known.")] = False
    drying_s: Annotated[float, Meta(
        ge=0, le=7200, title="Drying", extra={"unit": "s", "group": "Appearance", "slider_to": 600.0},
        description="Time in which what is wet dries to 1/e when the rain gets weaker; 0 dries at once.")] = 0.0
    # fmt: on

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.wind_m_s is not None:
            speed_m_s, from_deg = wind_on_compass(*self.wind_m_s)
            msgspec.structs.force_setattr(self, "wind_m_s", None)
            msgspec.structs.force_setattr(self, "wind_speed_m_s", speed_m_s)
            if speed_m_s > 0:
                msgspec.structs.force_setattr(self, "wind_from_deg", from_deg)

    @property
    def is_paper(self) -> bool:
        return self.model == "paper"

    @property
    def wind_vector_m_s(self) -> tuple[float, float]:
        """Mean wind at 10 m along world x (east) and y (north)."""
        turn = math.radians(self.wind_from_deg)
        x, y = (-self.wind_speed_m_s * each(turn) for each in (math.sin, math.cos))
        return round(x, 12) + 0.0, round(y, 12) + 0.0

    @property
    def without_rain(self) -> "RainSettings":
        """The same settings at 0 mm/h, dry and without fog, for the clear image of a rainy/clear pair."""
        return msgspec.structs.replace(self, intensity_mm_h=0.0, wetness=None, visibility_m=None)

    @property
    def without_medium(self) -> "RainSettings":
        """The same settings with the paper's Gaussians in place of a medium and fog, for output without distances."""
        if self.haze != "medium" and self.visibility_m is None:
            return self
        haze = "gaussians" if self.haze == "medium" else self.haze
        return msgspec.structs.replace(self, haze=haze, visibility_m=None)

    @property
    def haze_box(self) -> RegionBox:
        """Region of the paper's haze Gaussians."""
        return self.haze_region or HAZE_REGION

    @property
    def exaggeration(self) -> str:
        """Text that lists gains other than 1; empty if all gains are physical."""
        gains = {"streaks": self.streak_gain, "haze": self.haze_gain}
        return ", ".join(f"{name} x{gain:g} exaggerated" for name, gain in gains.items() if gain != 1)


def wind_on_compass(x_m_s: float, y_m_s: float) -> tuple[float, float]:
    """Speed in m/s, and the direction in degrees that a wind along world x (east) and y (north) blows from."""
    return math.hypot(x_m_s, y_m_s), math.degrees(math.atan2(-x_m_s, -y_m_s)) % 360


# Presets
# YAML files with the fields of `RainSettings`; omitted fields have their defaults.

_FOLDER = "rain"
RAIN_FILES = "calibration", "sensor", "lamps"
"""Fields that may name a file."""


def load_preset(name: str) -> RainSettings:
    """Load a shipped preset by name, or a preset file by path.

    Calibration and sensor files that it names are searched for in the preset's folder first. Raises `ValueError` with
    the file, the field and the allowed range.
    """
    from ..scene.sensor import sensor_names  # NumPy, which the help of commands does without
    from .calibration import calibration_names

    known = {*calibration_names(), *sensor_names(), *LAMP_WORDS}
    return load_config(_FOLDER, name, RainSettings, "preset", RAIN_FILES, known)
