"""Finding out what there is."""

from imgui_bundle import imgui

from ..shortcuts import chord
from .action import Action

HELP_ACTIONS = (
    Action(
        "Find a command...",
        lambda session: setattr(session.view, "dialog", "commands"),
        "Help",
        (chord(imgui.Key.mod_ctrl, imgui.Key.p), chord(imgui.Key.mod_ctrl, imgui.Key.mod_shift, imgui.Key.p)),
        "Type part of a name; Enter does it.",
    ),
    Action(
        "Keyboard and mouse",
        lambda session: setattr(session.view, "dialog", "keys"),
        "Help",
        chord(imgui.Key.f1),
        "Everything with its key, on one page.",
    ),
    Action(
        "About GSRAIN",
        lambda session: setattr(session.view, "dialog", "about"),
        "Help",
        help="Version, what draws, and where the method comes from.",
    ),
)
