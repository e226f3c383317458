"""The window's own icon, for title bars, docks and the list of windows."""

from importlib.resources import files
from typing import Any

import glfw
from PIL import Image

SIZES_PX = (16, 24, 32, 48, 64, 256)


def set_window_icon(window: Any) -> None:
    """Give the window its icon. Under Wayland windows have none of their own: there the desktop entry names it."""
    if glfw.get_platform() == glfw.PLATFORM_X11 or glfw.get_platform() == glfw.PLATFORM_WIN32:
        glfw.set_window_icon(window, len(SIZES_PX), read_icons())


def read_icons() -> list[Image.Image]:
    """The icon in each of `SIZES_PX`, RGBA."""
    icons = []
    for size in SIZES_PX:
        with (files("app") / "icons" / f"{size}.png").open("rb") as file:
            icons.append(Image.open(file).convert("RGBA"))
    return icons
