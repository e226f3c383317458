"""The keyboard page: what every key and mouse button does."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.session import Session

from ..actions import ACTIONS
from ..shortcuts import chord_name
from ..tools import TOOLS

TITLE = "Keyboard and mouse"

MOUSE_AND_FLIGHT = (
    ("Left drag", "Orbit, or what the tool does"),
    ("Right drag", "Look around"),
    ("Middle drag", "Move sideways and up"),
    ("Wheel", "Nearer, farther"),
    ("Ctrl+Wheel", "Fly faster or slower"),
    ("W A S D", "Fly forward, left, back, right"),
    ("Q E", "Fly down, up"),
    ("Shift", "Fly four times as fast"),
)


def keyboard_page(session: Session) -> None:
    if session.view.dialog == "keys" and not imgui.is_popup_open(TITLE):
        imgui.open_popup(TITLE)
    size = imgui.get_main_viewport().size
    imgui.set_next_window_size(ImVec2(0.8 * size.x, 0.8 * size.y), imgui.Cond_.appearing)
    imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing, ImVec2(0.5, 0.5))
    is_open, _ = imgui.begin_popup_modal(TITLE, True)
    if not is_open:
        if session.view.dialog == "keys":
            session.view.dialog = ""
        return
    tools = [(chord_name(int(tool.key)), f"Tool: {tool.name}") for tool in TOOLS if tool.key is not None]
    groups = [("Mouse and flight", list(MOUSE_AND_FLIGHT)), ("Tools", tools)]
    for menu in dict.fromkeys(action.menu for action in ACTIONS):
        actions = [(action.key_names, action.name) for action in ACTIONS if action.menu == menu and action.chords]
        groups.append((menu or "Other", actions))
    columns = max(1, int(imgui.get_content_region_avail().x / (26 * imgui.get_font_size())))
    if imgui.begin_table("groups", columns):
        for title, rows in groups:
            if rows:
                imgui.table_next_column()
                _group(title, rows)
        imgui.end_table()
    if imgui.is_key_pressed(imgui.Key.escape):
        session.view.dialog = ""
        imgui.close_current_popup()
    imgui.end_popup()


def _group(title: str, rows: list[tuple[str, str]]) -> None:
    imgui.separator_text(title)
    if imgui.begin_table(title, 2, imgui.TableFlags_.sizing_fixed_fit):
        for keys, what in rows:
            imgui.table_next_row()
            imgui.table_next_column()
            imgui.text_disabled(keys)
            imgui.table_next_column()
            imgui.text(what)
        imgui.end_table()
