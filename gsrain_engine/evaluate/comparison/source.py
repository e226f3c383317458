"""What all methods of a comparison start from: clear views, and real rainy pictures to be compared with."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Bool, Float64

from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.appearance.finetuning.pictures.open_pictures import open_pictures
from gsrain_engine.appearance.finetuning.pictures.picture import Picture
from gsrain_engine.appearance.finetuning.pictures.settings import PictureSettings
from gsrain_engine.appearance.views.capture_views import capture_views
from gsrain_engine.appearance.wet.picture_surroundings import PictureSurroundings
from gsrain_engine.appearance.wet.surroundings import Surroundings
from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.other_pictures import flat_name
from gsrain_engine.datasets.prepared import prepared

from .stamp import stamp


@dataclass(frozen=True, slots=True, eq=False)
class ComparedSource:
    """Clear views in the world, worked out when they are asked for."""

    name: str
    views: Sequence[ClearView]
    surroundings: Surroundings
    to_world: Float64[np.ndarray, "4 4"]
    """Similarity from the units and axes of the scene or capture to the world."""
    mask: Callable[[str], Bool[np.ndarray, "h w"] | None]
    """By name of a view, which of its pixels may be learned from; None means all."""
    has_cameras: bool
    """Whether it is known where the views were taken: only then can they be compared with each other."""
    stamp: str
    """Changes with the files that the views come from."""


def capture_source(capture: Capture, width_px: int, source_stamp: str) -> ComparedSource:
    """Take the pictures of a capture; wider ones are made `width_px` wide."""
    views = capture_views(capture, width_px)
    return ComparedSource(
        capture.name, views, PictureSurroundings(), views.to_world, views.mask, capture.has_poses, source_stamp
    )


def held_out_pictures(settings: PictureSettings, width_px: int) -> tuple[ComparedSource, Capture]:
    """Return the clear and the rainy pictures that a training with these settings never sees.

    They are whole, not framed as for the training: extractors stretch them as the paper's training does. Raises
    `CaptureError` where a source can't be read, and ValueError where nothing is held out.
    """
    split = open_pictures(msgspec.structs.replace(settings, guide="none"))
    if not split.test.source or not split.test.target:
        raise ValueError(f"pictures: test_share {settings.test_share:g} leaves no clear or no rainy picture to test")
    stamps = "-".join(stamp(Path(each.path)) for each in settings.clear)
    clear = _alone("clear test pictures", split.test.source)
    return capture_source(clear, width_px, stamps), _narrowed(
        _alone("rainy test pictures", split.test.target), width_px
    )


def real_pictures(folders: Sequence[Path], width_px: int) -> Capture:
    """Return the pictures of some folders or captures, of no larger width than the transferred ones.

    Pictures that were made smaller once more than others look different to an extractor. Raises `CaptureError` where
    one can't be read.
    """
    captures = [open_capture(folder) for folder in folders]
    return _narrowed(replace(captures[0], views=tuple(view for each in captures for view in each)), width_px)


def _alone(name: str, pictures: Sequence[Picture]) -> Capture:
    """Pictures of several sources, which know nothing of each other."""
    views = tuple(replace(each.view, name=flat_name(each.name), sensor="") for each in pictures)
    return Capture(name, views, is_metric=False, has_poses=False)


def _narrowed(capture: Capture, width_px: int) -> Capture:
    return replace(capture, views=tuple(prepared(view, min(width_px, view.camera.width)) for view in capture))
