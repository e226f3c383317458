"""Pictures that another program has made of the same views stand in for a transfer."""

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.other_pictures import pictures_below, sized_picture

from .clear_view import ClearView
from .transfer import RainyView

logger = logging.getLogger("gsrain")


class PictureStandIn:
    """A `Transfer` that reads pictures from a folder, matched by the views' names."""

    name = "images"

    def __init__(self, folder: Path) -> None:
        """Look for the pictures; raises `CaptureError` where there is no such folder."""
        self._pictures = pictures_below(folder)

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        """Read the picture of each view, resized to the view's size.

        Views without a picture are left out, and the log names one of them, and one of the pictures without a view.
        Raises `CaptureError` where no view has one, for a broken picture, and for one of other proportions.
        """
        missing, named = list[str](), list[tuple[str, str]]()
        for view in views:
            named.append((view.name, view.sensor))
            file = self._pictures.file_of(view.name, view.sensor)
            if file is None:
                missing.append(view.name)
                continue
            size = (view.camera.width, view.camera.height)
            yield RainyView(view, sized_picture(file, size).astype(np.float32) / np.float32(255))
        folder = self._pictures.folder
        if len(missing) == len(named):
            raise CaptureError(f"--images {folder}: has no picture of a view; expected {named[0][0]}.png, for one")
        if missing:
            logger.warning("%d views have no picture in %s, %r for one", len(missing), folder, missing[0])
        left_over = self._pictures.left_over(named)
        if left_over:
            logger.warning("%d pictures in %s belong to no view, %r for one", len(left_over), folder, left_over[0])
