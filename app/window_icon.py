"""The window's own icon, for title bars, docks and the list of windows."""

from importlib.resources import files
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

SIZES_PX = (16, 24, 32, 48, 64, 256)
_OF_WINDOWS_PX = 64
"""Larger ones are for menus: a window would only start later."""


def set_window_icon(window: Any) -> None:
    """Give the window its icon. Under Wayland windows have none of their own: there the desktop entry names it."""
    import glfw  # imgui_bundle has to come before it, and pictures need neither

    if glfw.get_platform() in (glfw.PLATFORM_X11, glfw.PLATFORM_WIN32):
        icons = [(size, size, read_icon(size).tolist()) for size in SIZES_PX if size <= _OF_WINDOWS_PX]
        glfw.set_window_icon(window, len(icons), icons)  # numbers: of Pillow's images glfw asks what is deprecated


def read_icon(size_px: int) -> UInt8[np.ndarray, "h w 4"]:
    """The icon in one of `SIZES_PX`, as RGBA that is not premultiplied."""
    with (files("app") / "icons" / f"{size_px}.png").open("rb") as file:
        return np.asarray(Image.open(file).convert("RGBA"))
