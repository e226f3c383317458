"""The menu bar, made of the actions; and which panels are shown."""

from imgui_bundle import hello_imgui, imgui

from gsrain_engine.session.session import Session

from .actions import ACTIONS
from .actions.action import Action

MENUS = ("File", "Edit", "Select", "Scene", "Rain", "Drive", "Timeline", "View", "Help")


def draw_menus(session: Session) -> None:
    """Draw the menus into the menu bar."""
    for title in MENUS:
        if imgui.begin_menu(title):
            for action in ACTIONS:
                if action.menu == title:
                    _item(session, action)
            if title == "View":
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


def _panels() -> None:
    """Say which panels are shown."""
    docking = hello_imgui.get_runner_params().docking_params
    if imgui.begin_menu("Panels"):
        for window in docking.dockable_windows:
            if window.can_be_closed:
                _, window.is_visible = imgui.menu_item(window.label, "", window.is_visible)
        imgui.separator()
        if imgui.menu_item("Put everything back in its place", "", False)[0]:
            docking.layout_reset = True
            for window in docking.dockable_windows:
                window.is_visible = True
        imgui.end_menu()
