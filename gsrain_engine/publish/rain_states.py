"""Rain of a page: what its script needs to place the drops of the desktop, for each step of the intensity slider."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32
from msgspec import structs

from ..rain.frame import SkyLight
from ..rain.properties import DropSizes, rain_class, turbulent_fall_share
from ..rain.settings import LARGEST_MM, SMALLEST_MM, RainSettings
from ..rain.shelter_map import ShelterMap, shelter_map_of
from ..rain.simulation import RainSimulation
from ..scene.camera import Camera
from ..scene.scene import Scene
from .page_ground import splash_state
from .page_mirror import mirror_state

STEPS_MM_H = 0.0, 0.5, 1.0, 2.5, 5.0, 8.5, 12.0, 18.0, 25.0, 35.0, 50.0
"""Intensities of the slider, besides the rain's own."""

OPENING_MM_H = 8.5
"""First place of the slider of a rain that is off."""

AROUND_PATH_M, _MOST_ROOFS_M = 60.0, 300.0  # of the roofs on a page; farther ones shelter nothing there

_UNLIKE_A_PAGE = (
    ("model", "physical", "the physical model"),
    ("haze", "medium", "--haze medium"), ("haze_region", None, "no haze region"), ("visibility_m", None, "no fog"),
    ("aperture_mm", None, "the sensor's aperture"), ("focus_distance_m", None, "the sensor's focus"),
)  # fmt: skip
"""Fields of the rain that a page draws in one way only, that way, and its name."""


class RainStates(NamedTuple):
    """Rain of a page."""

    settings: dict[str, Any]
    """Values common to all intensities, in the names of `rain.js`."""
    states: list[dict[str, Any]]
    """One for each step of the slider, rising."""
    roofs: ShelterMap | None
    """Roofs near the path; None without any."""
    impacts: Float32[np.ndarray, "states knots 2"]
    """Sizes of the drops that splash in each state, as `splash_state` has them."""
    chosen: int
    """Step at which the slider stands at first: the rain's own intensity, or `OPENING_MM_H`."""


def check_rain(rain: RainSettings) -> None:
    """Raise `ValueError` for a rain that a page can't draw."""
    for field, value, name in _UNLIKE_A_PAGE:
        if getattr(rain, field) != value:
            raise ValueError(f"{field} {getattr(rain, field)}: a page has {name} only")


def rain_states(
    rain: RainSettings, scene: Scene, sky: dict[bool, SkyLight], cameras: Sequence[Camera], exposure_s: float
) -> RainStates:
    """Tabulate a rain and the same rain at other intensities, for a path of cameras.

    `sky` is its light by whether it is overcast.
    """
    check_rain(rain)
    steps = sorted({*STEPS_MM_H, rain.intensity_mm_h})
    simulations = [RainSimulation.start(structs.replace(rain, intensity_mm_h=step)) for step in steps]
    first = simulations[0]
    wind, sensor, region = first.motion.wind, first.sensor, rain.streak_region
    phases, _, _ = wind.modes(0.0, 0.0, 0.0, 0.0)
    quadratic = None if rain.velocity == "atlas" else list(first.calibration.velocity.coefficients)
    settings = {
        "seed": rain.seed,
        "region": {"minimum": region.minimum_m, "maximum": region.maximum_m},
        "ground": scene.ground_m,
        "wind": {
            "mean": wind.mean_m_s, "gust": wind.gust_m_s, "turbulence": wind.turbulence_m_s,
            "roughness": wind.roughness_m, "phases": phases.tolist(),
        },
        "fallSpeed": {"quadratic": quadratic, "share": turbulent_fall_share(rain.turbulence_m_s)},
        "sensor": {
            "rows": sensor.size_px[1], "pitch": sensor.pixel_pitch_um, "fNumber": sensor.f_number,
            "focus": sensor.focus_distance_m, "readout": sensor.readout_s,
        },
        "exposure": exposure_s,
        "criticalHaze": rain.critical_haze_coefficient,
        "hazeOpacity": rain.haze_opacity,
        "hazeGain": rain.haze_gain,
        "streakGain": rain.streak_gain,
        "maxCopies": rain.max_copies,
    }  # fmt: skip
    splashes = [splash_state(simulation, scene) for simulation in simulations]
    states = [
        {**_state(simulation, scene, sky), "splashes": found}
        for simulation, (found, _) in zip(simulations, splashes, strict=True)
    ]
    impacts = np.stack([sizes for _, sizes in splashes]).astype(np.float32)
    roofs = shelter_map_of(scene) if rain.roofs else None
    if roofs is not None:
        places = np.array([camera.position[:2] for camera in cameras])
        (x, y), (high_x, high_y) = places.min(axis=0), places.max(axis=0)
        reach_m = min(float(np.hypot(high_x - x, high_y - y)) / 2 + AROUND_PATH_M, _MOST_ROOFS_M)
        roofs = roofs.around(float(x + high_x) / 2, float(y + high_y) / 2, reach_m)
    if roofs is not None:
        rows, columns = roofs.heights_m.shape
        settings["roofs"] = {"rows": rows, "columns": columns, "corner": roofs.corner_m, "cell": roofs.cell_m}
    return RainStates(settings, states, roofs, impacts, steps.index(rain.intensity_mm_h or OPENING_MM_H))


def _state(simulation: RainSimulation, scene: Scene, sky: dict[bool, SkyLight]) -> dict[str, Any]:
    state, overcast = simulation.state, simulation.overcast_at(0.0)
    light = sky[False].mixed(sky[True], overcast)
    own = simulation.rain.drop_color
    return {
        "intensity": state.intensity_mm_h,
        "class": rain_class(state.intensity_mm_h),
        "sizes": _sizes(state.sizes),
        "density": state.density_m3 if simulation.rain.streaks else 0.0,
        "extinction": state.extinction_per_m,
        "wetness": simulation.soaked_share_at(0.0),
        "overcast": overcast,
        "drops": own or light.drops,
        "airlight": own or light.airlight,
        "mirror": mirror_state(simulation, scene, light),
    }


def _sizes(sizes: DropSizes) -> dict[str, float]:
    """Gamma law of the diameters (mm), of density x^(shape - 1) e^-x e^-logarithm, with x the diameter in scales."""
    x = sizes.shape
    density = float(sizes.probability_per_mm(np.array([sizes.scale_mm * x]))[0])
    return {
        "shape": sizes.shape, "scale": sizes.scale_mm, "smallest": SMALLEST_MM, "largest": LARGEST_MM,
        "logarithm": float((sizes.shape - 1) * np.log(x) - x - np.log(density)),
    }  # fmt: skip
