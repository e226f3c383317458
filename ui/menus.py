"""The menu bar, made of the actions; and which panels are shown."""

from imgui_bundle import hello_imgui, imgui

from gsrain_engine.session.session import Session

from .actions import ACTION_GROUPS
from .actions.action import Action
from .panel_windows import bring_to_front, panel_windows
from .widgets.names import label

MENUS = ("File", "Edit", "Select", "Scene", "Rain", "Drive", "Timeline", "View", "Help")


def draw_menus(session: Session) -> None:
    for title in MENUS:
        if imgui.begin_menu(title):
            groups = [[action for action in group if action.menu == title] for group in ACTION_GROUPS]
            for number, group in enumerate(filter(None, groups)):
                if number:
                    imgui.separator()
                for action in group:
                    _item(session, action)
                if title == "File" and number == 0:
                    _recent(session)
            if title == "View":
                imgui.separator()
                _panels()
            imgui.end_menu()


def _item(session: Session, action: Action) -> None:
    is_on = action.is_on is not None and action.is_on(session)
    keys = action.key_names.split(" or ")[0]
    clicked, _ = imgui.menu_item(action.title(session), keys, is_on, action.is_possible(session))
    if action.help:
        imgui.set_item_tooltip(action.help)
    if clicked:
        action.run(session)


def _recent(session: Session) -> None:
    """Open a scene of last time."""
    if imgui.begin_menu("Open recent", bool(session.files.recent)):
        for path in session.files.recent:
            if imgui.menu_item(label(path.name, str(path)), "", False)[0]:
                session.open(str(path))
            imgui.set_item_tooltip(str(path))
        imgui.end_menu()


def _panels() -> None:
    if imgui.begin_menu("Panels"):
        for window in panel_windows():
            clicked, window.is_visible = imgui.menu_item(window.label, "", window.is_visible)
            if clicked and window.is_visible:
                bring_to_front(window)
        imgui.separator()
        if imgui.menu_item("Put everything back in its place", "", False)[0]:
            hello_imgui.get_runner_params().docking_params.layout_reset = True
            for window in panel_windows():
                window.is_visible = True
        imgui.end_menu()
