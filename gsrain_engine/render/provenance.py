"""PictureProvenance of a picture: what its frame input held, as plain values that draw the same picture again."""

from typing import Any

import msgspec
import numpy as np

from ..choices import RenderMode
from ..rain.frame import SkyLight
from ..rain.keyframes import RainKeyframes
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..scene.camera import Camera
from ..scene.scene import Scene
from .frame_input import FrameInput, Quality
from .level_of_detail import LodCut
from .passes import registry
from .photograph import Photograph
from .view import RenderView


class LightRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Light of the sky at the time of a picture, as display colors, and how wet the scene was."""

    drops: tuple[float, float, float]
    airlight: tuple[float, float, float]
    overcast: float
    wetness: float


class PictureProvenance(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything that one picture held. `frame_of` draws it again."""

    source: str
    """Name of the scene, or of the capture of a photograph."""
    time_s: float
    intensity_mm_h: float
    """At that time, as all figures of the rain here."""
    haze: str
    """Haze that was drawn: medium, gaussians or none."""
    extinction_per_m: float
    fog_extinction_per_m: float
    calibration: str
    seed: int
    light: LightRecord
    photo_light: str | None = None
    """Light of a photograph in words, such as `softened to overcast (sun 0.82)`; None for a scene."""
    distances: str
    """Distances of what the medium is in front of: those of the scene, measured, or assumed ones of a level road."""
    passes: tuple[str, ...]
    """Passes that were drawn."""
    left_out: tuple[str, ...]
    """Passes that were not: switched off, or there was nothing to draw."""
    rain: dict[str, Any]
    """All settings of the rain, without keyframes."""
    weather: dict[str, Any] | None
    """Keyframes of the rain."""
    camera: dict[str, Any]
    exposure_s: float
    velocity_m_s: tuple[float, float, float] | None
    focal_px: float | None
    exposure_share: float
    mode: RenderMode
    merges_details: bool
    is_clear: bool
    without: tuple[str, ...]
    """Passes that were left out on purpose."""


def provenance_of(frame: FrameInput) -> PictureProvenance:
    """Return what a picture holds."""
    simulation, view, falling = frame.simulation, frame.view, frame.falling
    simulation = simulation or RainSimulation.start(RainSettings())
    state = simulation.state_at(frame.time_s)
    drawn = tuple(each.name for each in registry.PASSES if each.name not in frame.without and each.active(frame))
    haze = "none"
    if falling is not None and "medium" in drawn:
        haze = falling.rain.haze
    distances = "scene"
    if frame.photograph is not None:
        distances = "level road (assumed)" if frame.photograph.distances.are_assumed else "measured"
    weather = simulation.weather
    velocity = None if view.velocity_m_s is None else tuple(np.asarray(view.velocity_m_s, np.float64).tolist())
    return PictureProvenance(
        source=frame.scene.name, time_s=frame.time_s, intensity_mm_h=state.intensity_mm_h, haze=haze,
        extinction_per_m=state.extinction_per_m if haze != "none" else 0.0,
        fog_extinction_per_m=state.fog_extinction_per_m if "medium" in drawn else 0.0,
        calibration=simulation.rain.calibration, seed=simulation.rain.seed,
        light=LightRecord(
            drops=simulation.rain.drop_color or frame.light.drops,
            airlight=simulation.rain.drop_color or frame.light.airlight,
            overcast=0.0 if frame.rainfall is None else frame.rainfall.overcast_at(frame.time_s),
            wetness=frame.wetness,
        ),
        photo_light=None if frame.photograph is None else frame.photograph.light.words,
        distances=distances, passes=drawn,
        left_out=tuple(each.name for each in registry.PASSES if each.name not in drawn),
        rain=msgspec.to_builtins(simulation.rain), weather=msgspec.to_builtins(weather) if weather.keys else None,
        camera=view.camera.to_json(), exposure_s=view.camera.exposure_s, velocity_m_s=velocity, focal_px=view.focal_px,
        exposure_share=view.exposure_share, mode=frame.quality.mode,
        merges_details=isinstance(frame.quality.thinning, LodCut), is_clear=frame.is_clear,
        without=tuple(sorted(frame.without)),
    )  # fmt: skip


def frame_of(provenance: PictureProvenance, scene: Scene, photograph: Photograph | None = None) -> FrameInput:
    """Return the picture again, of the scene, or of the photograph, that it was made of.

    A photograph is drawn in the light that it has: where `photo_light` is softened, that of `CapturePhotos.frame`.
    Water on the glass of a moving camera is that of one which has always been at rest. Raises `ValueError` for settings
    out of bounds, and for a calibration, sensor or file of lamps that is missing.
    """
    rain = msgspec.convert(provenance.rain, RainSettings)
    weather = None if provenance.weather is None else msgspec.convert(provenance.weather, RainKeyframes)
    camera = Camera.from_json(provenance.camera | {"exposure_s": provenance.exposure_s}, "provenance")
    velocity = None if provenance.velocity_m_s is None else np.array(provenance.velocity_m_s)
    view = RenderView(camera, provenance.time_s, velocity, provenance.focal_px, provenance.exposure_share)
    light = SkyLight(provenance.light.drops, provenance.light.airlight)
    quality = Quality(provenance.mode, thinning=LodCut() if provenance.merges_details else None)
    return FrameInput.of(
        scene, RainSimulation.start(rain, weather=weather), light, view, quality,
        is_clear=provenance.is_clear, without=provenance.without, photograph=photograph,
    )  # fmt: skip
