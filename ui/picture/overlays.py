"""What is drawn over the picture whatever tool is in use: the one table."""

from collections.abc import Callable

from gsrain_engine.session.session import Session

from ..widgets.viewport import Viewport
from .capture_overlay import capture_overlay
from .drive_overlay import drive_overlay
from .matching_overlay import matching_overlay
from .path_overlay import path_overlay

Overlay = Callable[[Session, Viewport], bool]
"""Draws into the window's draw list; returns whether the left mouse button is its own now (a handle is held)."""

OVERLAYS: tuple[Overlay, ...] = (capture_overlay, matching_overlay, path_overlay, drive_overlay)
