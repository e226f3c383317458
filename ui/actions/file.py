"""Opening and saving."""

from pathlib import Path

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from ..file_dialogs import ask_what_to_open, ask_where_to_save
from ..shortcuts import chord
from .action import Action

_SCENES = "Scenes{.ply,.splat,.spz,.ksplat,.sog,.json},All files{.*}"
_SAVED = "Scene files{.ply,.splat,.spz},Scene folders{.*}"


def _open(session: Session, chosen: Path) -> None:
    session.open(str(chosen.parent if chosen.name == "scene.json" else chosen))


FILE_ACTIONS = (
    Action(
        "Open...",
        lambda session: ask_what_to_open("Open a scene", _SCENES, lambda chosen: _open(session, chosen[0])),
        "File",
        chord(imgui.Key.mod_ctrl, imgui.Key.o),
        "Open a scene file or folder.",
    ),
    Action(
        "Open the built-in street",
        lambda session: session.open("street"),
        "File",
        help="A street with cars and trees that needs no download.",
    ),
    Action(
        "Save as...",
        lambda session: ask_where_to_save("Save the scene", _SAVED, lambda chosen: session.save(chosen[0])),
        "File",
        chord(imgui.Key.mod_ctrl, imgui.Key.s),
        "Save as a scene folder, which keeps everything, or as one file.",
    ),
)
