"""Keys of actions and tools: they work everywhere in the window, unless a text field has them."""

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from .actions import ACTIONS
from .shortcuts import chord
from .tools import TOOLS


def act_on_keys(session: Session) -> None:
    """Do what the keys ask for that were pressed since the last frame."""
    if imgui.get_io().want_text_input:
        return
    for tool in TOOLS:
        if tool.key is not None and imgui.is_key_chord_pressed(chord(tool.key)):
            session.view.tool = "" if session.view.tool == tool.name else tool.name
    for action in ACTIONS:
        if any(imgui.is_key_chord_pressed(keys) for keys in action.chords):
            action.perform(session)
