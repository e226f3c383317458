"""Drawing of a picture: its passes, then one depth-ordered compositing."""

from functools import partial

from ..scene.gaussians import IdentityKey
from ..scene.scene import DrawItem
from ..water.mirror import LensMirror
from .bands import PictureBands
from .cpu.renderer import CpuRenderer
from .frame_input import FILTERS, FrameInput
from .level_of_detail import subset_items
from .passes import registry
from .passes.base import FrameParts
from .passes.mirror import reflecting_items
from .passes.sensor import metered
from .photograph import without_medium
from .renderer import DrawnPicture, PictureFilter, Renderer, timed


def draw(renderer: Renderer, frame: FrameInput) -> DrawnPicture:
    """Draw a picture by a renderer. Read it before the renderer draws the next one.

    Raises `ValueError` for glass before
    a camera with a lens, and `MemoryError` if it has no room.
    """
    parts, times_ms = FrameParts(renderer, partial(draw, renderer)), dict[str, float]()
    for each in registry.PASSES:
        if each.name not in frame.without:
            with timed(times_ms, each.name):
                if each.active(frame):
                    each.add(frame, parts)
    source = _composite(frame, parts)
    return DrawnPicture(renderer, source, tuple(parts.filters), times_ms, parts.compose)


def _composite(frame: FrameInput, parts: FrameParts) -> Renderer | PictureBands:
    """Draw what the passes have added; returns what the picture is read from."""
    quality, renderer, camera = frame.quality, parts.renderer, frame.view.camera
    still, mirror = parts.still, parts.mirror
    if still is None or not isinstance(renderer, CpuRenderer) or isinstance(mirror, LensMirror):
        source, rain = quality.bands or renderer, parts.rain
        if rain is not None and frame.photograph is not None:
            rain = without_medium(rain)
        source.draw(parts.items, camera, rain, with_depth=quality.with_depth, mode=quality.mode, mirror=mirror)
        return source

    def behind() -> list[DrawItem]:
        chosen = list(subset_items(parts.behind, quality.thinning, camera))
        return chosen if mirror is None else reflecting_items(chosen, frame.scene)

    rainfall, weather = frame.simulation, None
    if rainfall is not None and rainfall.weather.keys:
        weather = rainfall.rain, IdentityKey(rainfall.weather)
    still.draw(renderer, parts.behind, behind, parts.items, camera, parts.rain, mirror, weather)
    return renderer


def filters_of(renderer: Renderer, frame: FrameInput) -> tuple[PictureFilter, ...]:
    """Glass and sensor of a picture that is put together from several drawings."""
    parts = FrameParts(renderer, partial(draw, renderer))
    for each in registry.PASSES:
        if each.name in FILTERS and each.name not in frame.without and each.active(frame):
            each.add(frame, parts)
    return tuple(parts.filters)


def meter(renderer: Renderer, frame: FrameInput) -> None:
    """Meter automatic exposure at a picture, for all later ones of its camera, unless that was done before."""
    metered(frame, partial(draw, renderer))
