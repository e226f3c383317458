"""What a viewport without a scene offers: the street, the scenes of last time, a file."""

from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.session.session import Session

from ..actions import ACTIONS
from ..widgets.names import label

_WIDTH_EM = 30.0
_OFFERED = ("Open...", "Open the built-in street")
_MOST_RECENT = 6


def empty_state(session: Session, corner: ImVec2, width: int, height: int) -> None:
    """Draw the offers while there is no scene and none is on its way."""
    if session.scene.members or session.busy is not None:
        return
    wide = min(_WIDTH_EM * imgui.get_font_size(), width - 20.0)
    imgui.set_cursor_screen_pos(ImVec2(corner.x + (width - wide) / 2, corner.y + 0.25 * height))
    flags = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding
    if imgui.begin_child("empty", ImVec2(wide, 0), flags):
        imgui.text_wrapped("No scene is open. Drop a scene file or folder here, or begin with one of these.")
        imgui.spacing()
        for action in ACTIONS:
            if action.name in _OFFERED and imgui.button(action.name, ImVec2(-1, 0)):
                action.perform(session)
        recent = session.files.recent[:_MOST_RECENT]
        if recent:
            imgui.separator_text("Recent")
        for path in recent:
            if imgui.button(
                label(f"{icons_fontawesome_6.ICON_FA_CLOCK_ROTATE_LEFT}  {path.name}", str(path)), ImVec2(-1, 0)
            ):
                session.open(str(path))
            imgui.set_item_tooltip(str(path))
    imgui.end_child()
