"""What `gsrain transfer` makes rainy: views of a scene, or the pictures of a capture."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64

from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.appearance.views.choice import OWN_WIDTH_PX, ViewChoice, chosen_cameras, chosen_views
from gsrain_engine.appearance.wet.surroundings import Surroundings
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.open_scene import open_scene

from .sources import names_scene


@dataclass(frozen=True, slots=True, eq=False)
class SourceViews:
    """Views in the world, worked out when they are asked for, and what lies around them."""

    name: str
    views: Sequence[ClearView]
    surroundings: Surroundings
    to_world: Float64[np.ndarray, "4 4"]
    """Similarity from the units and axes of the scene or capture to the world."""
    width_px: int
    """Of the widest picture."""
    mask: Callable[[str], Bool[np.ndarray, "h w"] | None]
    """By name of a view, which pixels may be learned from; None means all."""


def source_views(source: str, choice: ViewChoice, capture: Path | None) -> SourceViews:
    """Open a scene or a capture; `capture` is where a scene's recorded cameras come from.

    Raises ValueError, which names the option, where the choice does not fit.
    """
    if names_scene(source):
        return _of_scene(source, choice, capture)
    if choice.source not in ("auto", "recorded"):
        raise ValueError(f"--views {choice.source}: {source} is a capture, whose views are those of its pictures")
    if capture is not None:
        raise ValueError(f"--capture: {source} is a capture itself")
    return _of_capture(Path(source), choice)


def _of_scene(source: str, choice: ViewChoice, capture: Path | None) -> SourceViews:
    from gsrain_engine.appearance.views.scene_views import scene_views  # kernels take a second to load
    from gsrain_engine.appearance.wet.scene_surroundings import SceneSurroundings

    if choice.source == "recorded" and capture is None:
        raise ValueError("--views recorded needs --capture, where the cameras come from")
    scene = open_scene(source)
    placed = chosen_cameras(scene, choice, None if capture is None else open_capture(capture), OWN_WIDTH_PX)
    width_px = max(each.camera.width for each in placed)
    views, around = scene_views(scene, placed), SceneSurroundings(scene)
    return SourceViews(scene.name, views, around, scene.scene_to_world, width_px, lambda name: None)


def _of_capture(source: Path, choice: ViewChoice) -> SourceViews:
    from gsrain_engine.appearance.views.capture_views import capture_views
    from gsrain_engine.appearance.wet.picture_surroundings import PictureSurroundings

    most_px = choice.width_px or OWN_WIDTH_PX
    capture = chosen_views(open_capture(source), choice)
    views, width_px = capture_views(capture, most_px), max(min(most_px, view.camera.width) for view in capture)
    return SourceViews(capture.name, views, PictureSurroundings(), views.to_world, width_px, views.mask)
