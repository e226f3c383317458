"""Selection sets in the Select panel: save what is selected, come back to it, rename, delete."""

from typing import get_args

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.selection import steps
from gsrain_engine.session.selection.combine import Mode
from gsrain_engine.session.session import Session

from ..widgets.names import label

_SIGNS: dict[Mode, tuple[str, str]] = {
    "set": (icons_fontawesome_6.ICON_FA_ARROW_POINTER, "Select the Gaussians of this set."),
    "add": (icons_fontawesome_6.ICON_FA_PLUS, "Add the Gaussians of this set."),
    "remove": (icons_fontawesome_6.ICON_FA_MINUS, "Take away the Gaussians of this set."),
    "intersect": (icons_fontawesome_6.ICON_FA_CIRCLE_HALF_STROKE, "Keep only what is in this set too."),
}


def selection_sets(session: Session, count: int) -> None:
    options = session.selecting
    imgui.begin_disabled(count == 0)
    imgui.set_next_item_width(-4.5 * imgui.get_font_size())
    flags = imgui.InputTextFlags_.enter_returns_true
    hint = steps.free_name(session.scene)
    entered, options.set_name = imgui.input_text_with_hint("##set name", hint, options.set_name, flags)
    imgui.set_item_tooltip("What the set is called; a set of the same name is replaced.")
    imgui.same_line()
    if (imgui.button("Save", (-1, 0)) or entered) and steps.save_set(session, options.set_name.strip() or None):
        options.set_name = ""
    imgui.set_item_tooltip("Keep what is selected under this name, in the scene's file.")
    imgui.end_disabled()
    if not session.scene.selections:
        imgui.text_disabled("No sets yet. Select something and save it.")
        return
    table = imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_fixed_fit
    if imgui.begin_table("sets", 3, table):
        imgui.table_setup_column("name", imgui.TableColumnFlags_.width_stretch)
        for number, (name, masks) in enumerate(session.scene.selections.items()):
            imgui.push_id(number)
            _row(session, name, sum(mask.size for mask in masks.values()))
            imgui.pop_id()
        imgui.end_table()


def _row(session: Session, name: str, size: int) -> None:
    imgui.table_next_row()
    imgui.table_next_column()
    _name(session, name)
    imgui.table_next_column()
    imgui.align_text_to_frame_padding()
    imgui.text_disabled(f"{size:,}")
    imgui.set_item_tooltip("Gaussians in this set.")
    imgui.table_next_column()
    for mode in get_args(Mode):
        icon, help_text = _SIGNS[mode]
        if imgui.small_button(f"{icon}###recall {mode}"):
            steps.recall_set(session, name, mode)
        imgui.set_item_tooltip(help_text)
        imgui.same_line(0, 3)
    if imgui.small_button(f"{icons_fontawesome_6.ICON_FA_TRASH}###delete"):
        steps.remove_set(session, name)
    imgui.set_item_tooltip("Forget this set; what is selected stays.")


def _name(session: Session, name: str) -> None:
    """Draw the name; a double click lets it be typed."""
    options = session.selecting
    if options.renamed_set != name:
        imgui.align_text_to_frame_padding()
        imgui.selectable(label(name), False)
        imgui.set_item_tooltip(f"{name}: double-click to rename.")
        if imgui.is_item_hovered() and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            options.renamed_set = options.new_name = name
        return
    imgui.set_next_item_width(-1)
    if imgui.is_window_appearing() or not imgui.is_any_item_active():
        imgui.set_keyboard_focus_here()
    flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
    entered, options.new_name = imgui.input_text("##new name", options.new_name, flags)
    imgui.set_item_tooltip("Enter keeps the name, Esc leaves the old one.")
    if entered:
        steps.rename_set(session, name, options.new_name)
    if entered or imgui.is_item_deactivated():
        options.renamed_set = ""
