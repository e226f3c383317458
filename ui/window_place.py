"""Place, size and maximized state of the window: noted while it is open, and taken by the next one."""

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

# imgui_bundle brings its own GLFW library and has to be imported before the glfw package.
from imgui_bundle import hello_imgui

import glfw  # isort: skip

from gsrain_engine.editor.preferences import WindowPlace


class Monitor(NamedTuple):
    """Part of a monitor that windows may cover, in pixels of the desktop, and its scale, such as 2.0."""

    x: int
    y: int
    width: int
    height: int
    scale: float = 1.0


def monitors() -> list[Monitor]:
    """Return the monitors of the desktop, the primary one first; none before GLFW has begun."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", glfw.GLFWError)
        handles = glfw.get_monitors()
        areas = [glfw.get_monitor_workarea(each) for each in handles]
        scales = [float(glfw.get_monitor_content_scale(each)[0]) or 1.0 for each in handles]
        is_scaled = bool(handles) and glfw.get_platform() not in (glfw.PLATFORM_COCOA, glfw.PLATFORM_WAYLAND)
    return [Monitor(*area, scale if is_scaled else 1.0) for area, scale in zip(areas, scales, strict=True)]


def fitted(place: WindowPlace, present: Sequence[Monitor]) -> WindowPlace:
    """Move and shrink a place so that it is within one of the present monitors.

    It has no position where the monitor is gone on which it was. Without any monitors it stays as it is.
    """
    if not present:
        return place
    x, y = place.position or (0, 0)

    def overlap(monitor: Monitor) -> float:
        wide, tall = (monitor.scale * each for each in place.size)
        right, low = min(x + wide, monitor.x + monitor.width), min(y + tall, monitor.y + monitor.height)
        return max(right - max(x, monitor.x), 0.0) * max(low - max(y, monitor.y), 0.0)

    here = max(present, key=overlap)  # of equals, the first
    wide, tall = (round(here.scale * each) for each in place.size)
    wide, tall = min(wide, here.width), min(tall, here.height)
    size = round(wide / here.scale), round(tall / here.scale)
    if place.position is None or not overlap(here):
        return WindowPlace(position=None, size=size, is_maximized=place.is_maximized)
    position = min(max(x, here.x), here.x + here.width - wide), min(max(y, here.y), here.y + here.height - tall)
    return WindowPlace(position=position, size=size, is_maximized=place.is_maximized)


def open_at(place: WindowPlace, parameters: hello_imgui.RunnerParams) -> None:
    """Let a window open at a place; it is maximized when it is there."""
    geometry = parameters.app_window_params.window_geometry
    geometry.size = place.size
    if place.position is not None:
        geometry.position, geometry.position_mode = place.position, hello_imgui.WindowPositionMode.from_coords


def place_of(window: Any, before: WindowPlace | None) -> WindowPlace | None:
    """Return the place of a window; of a maximized or minimized one, that which it had `before`."""
    is_maximized = bool(glfw.get_window_attrib(window, glfw.MAXIMIZED))
    if glfw.get_window_attrib(window, glfw.ICONIFIED):
        return before
    if is_maximized and before is not None:
        return WindowPlace(position=before.position, size=before.size, is_maximized=True)
    scale = hello_imgui.get_dpi_aware_params().dpi_window_size_factor or 1.0
    wide, tall = (round(each / scale) for each in glfw.get_window_size(window))
    position = None
    if glfw.get_platform() != glfw.PLATFORM_WAYLAND:  # which does not tell it
        x, y = glfw.get_window_pos(window)
        position = x, y
    return WindowPlace(position=position, size=(max(wide, 1), max(tall, 1)), is_maximized=is_maximized)
