"""Looking at the scene: where from, when, and how it is shown."""

from collections.abc import Callable
from typing import get_args

from imgui_bundle import imgui

from gsrain_engine.render.look import Look
from gsrain_engine.session.session import Session
from gsrain_engine.session.view.view_options import Split

from ..shortcuts import chord
from .action import Action

_KEY = imgui.Key


def _set(field: str, value: object) -> Callable[[Session], None]:
    return lambda session: setattr(session.view, field, value)


def _is(field: str, value: object) -> Callable[[Session], bool]:
    return lambda session: getattr(session.view, field) == value


def _toggle(field: str) -> Callable[[Session], None]:
    return lambda session: setattr(session.view, field, not getattr(session.view, field))


VIEW_ACTIONS = (
    Action(
        "Frame the scene",
        lambda session: session.frame_scene(),
        "View",
        chord(_KEY.f),
        "Back off until what is chosen under Layers, or else the whole scene, can be seen.",
    ),
    Action(
        "Go home",
        lambda session: session.go_home(),
        "View",
        (chord(_KEY.r), chord(_KEY.home)),
        "Back to where the scene was first looked at from.",
    ),
    Action(
        "Show the selection",
        _toggle("show_selection"),
        "View",
        chord(_KEY.mod_shift, _KEY.s),
        "Tint what is selected.",
        is_on=_is("show_selection", True),
    ),
    Action(
        "Take a screenshot",
        lambda session: session.take_screenshot(),
        "View",
        chord(_KEY.f12),
        "Save the picture as PNG in the pictures folder; the log says where.",
    ),
    *(
        Action(
            f"Look: {look}",
            _set("look", look),
            help="Show the picture, or what it is made of.",
            is_on=_is("look", look),
        )
        for look in get_args(Look)
    ),
    *(
        Action(
            f"Compare: {split}",
            _set("split", split),
            help="Two pictures side by side; drag the line between them.",
            is_on=_is("split", split),
        )
        for split in get_args(Split)
    ),
    Action(
        "Play or pause", lambda session: session.clock.toggle(), "View", chord(_KEY.space), "Let time go on or stop it."
    ),
    Action("Navigate", _set("tool", ""), "", chord(_KEY.escape), "Put the tool away: the left button orbits again."),
)
