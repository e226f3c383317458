"""The menu bar, made of the actions."""

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from .actions import ACTIONS
from .actions.action import Action

MENUS = ("File", "Edit", "Select", "Scene", "Rain", "Timeline", "View", "Help")


def draw_menus(session: Session) -> None:
    """Draw the menus into the menu bar."""
    for title in MENUS:
        actions = [action for action in ACTIONS if action.menu == title]
        if actions and imgui.begin_menu(title):
            for action in actions:
                _item(session, action)
            imgui.end_menu()


def _item(session: Session, action: Action) -> None:
    is_on = action.is_on is not None and action.is_on(session)
    keys = action.key_names.split(", ")[0]
    clicked, _ = imgui.menu_item(action.title(session), keys, is_on, action.is_possible(session))
    if action.help:
        imgui.set_item_tooltip(action.help)
    if clicked:
        action.run(session)
