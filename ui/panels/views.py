"""Views panel: named views with their pictures; a click goes to one."""

from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.editor.views import NamedViews
from gsrain_engine.scene.named_view import NamedView

from ..commands.table import help_of
from ..widgets.fields import button, checkbox, faint, menu_item
from ..widgets.text import plain_identity, visible_name

_PICTURE_EM, _ASPECT = 3.0, 1.5  # height of a row's picture, and its width over that
_DELETE = icons_fontawesome_6.ICON_FA_TRASH


def views_panel(views: NamedViews) -> None:
    width = -4.5 * imgui.get_font_size()
    if name_field(views, width):
        views.save_typed()
    imgui.same_line()
    if button("Save", help_of("Save view as..."), width=-1, enabled=views.can_save):
        views.save_typed()
    view_options(views)
    if not views.views:
        faint("No views yet: save the present one, and come back to it by a click.")
        return
    if imgui.begin_child("views"):
        for number, view in enumerate(views.views):
            _row(views, number, view)
    imgui.end_child()


def name_field(views: NamedViews, width: float) -> bool:
    """Draw the field for the name of the next view; returns True if Enter was pressed."""
    imgui.set_next_item_width(width)
    flags = imgui.InputTextFlags_.enter_returns_true
    entered, views.typed = imgui.input_text_with_hint("##view name", views.unused_name, views.typed, flags)
    imgui.set_item_tooltip("Name of the view; a view of the same name is set to the present one.")
    return entered and views.can_save


def view_options(views: NamedViews) -> None:
    """Draw what a view holds besides the camera."""
    imgui.align_text_to_frame_padding()
    imgui.text("With")
    imgui.same_line()
    views.with_time = checkbox("time", views.with_time, "The view also holds the time of scene and rain.")
    imgui.same_line()
    help_text = "The view also holds the settings of the rain; going there sets them, as a step of the history."
    views.with_rain = checkbox("rain", views.with_rain, help_text)


def _row(views: NamedViews, number: int, view: NamedView) -> None:
    em, gap, identity = imgui.get_font_size(), imgui.get_style().item_spacing.x, plain_identity(view.name)
    corner, height = imgui.get_cursor_screen_pos(), _PICTURE_EM * em
    flags = imgui.SelectableFlags_.allow_double_click | imgui.SelectableFlags_.allow_overlap
    clicked, _ = imgui.selectable(f"###view {identity}", views.chosen == view.name, flags, ImVec2(0, height))
    key = f" (Ctrl+{number + 1})" if number < 9 else ""
    imgui.set_item_tooltip(f"{view.name}: click to go there{key}. Double click or F2: rename. Right click: menu.")
    is_double = clicked and imgui.is_mouse_double_clicked(imgui.MouseButton_.left)
    if imgui.begin_popup_context_item():
        _menu(views, view.name)
        imgui.end_popup()
    below, draw, width = imgui.get_cursor_screen_pos(), imgui.get_window_draw_list(), _ASPECT * height
    texture = views.textures.get(view.name)
    if texture is not None:
        draw.add_image(imgui.ImTextureRef(texture.name), corner, ImVec2(corner.x + width, corner.y + height))
    else:
        ink = imgui.get_color_u32(imgui.Col_.frame_bg)
        draw.add_rect_filled(corner, ImVec2(corner.x + width, corner.y + height), ink)
    left = corner.x + width + gap
    if views.renamed == view.name:
        imgui.set_cursor_screen_pos(ImVec2(left, corner.y + (height - imgui.get_frame_height()) / 2))
        _rename(views, view.name)
        imgui.set_cursor_screen_pos(below)
    else:
        draw.add_text(ImVec2(left, corner.y + 0.4 * em), imgui.get_color_u32(imgui.Col_.text), visible_name(view.name))
        ink = imgui.get_color_u32(imgui.Col_.text_disabled)
        draw.add_text(ImVec2(left, corner.y + 1.6 * em), ink, view.contents)
    if is_double:
        views.begin_renaming(view.name)
    elif clicked:
        views.go_to(view.name)


def _rename(views: NamedViews, name: str) -> None:
    imgui.set_next_item_width(-1)
    if views.is_naming_new:
        imgui.set_keyboard_focus_here()
    flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
    entered, views.new_name = imgui.input_text("##new view name", views.new_name, flags)
    imgui.set_item_tooltip("Enter applies the name, Esc cancels.")
    if entered:
        views.rename(name, views.new_name)
    if entered or (imgui.is_item_deactivated() and not views.is_naming_new):
        views.renamed = ""
    views.is_naming_new = False


def _menu(views: NamedViews, name: str) -> None:
    views.chosen = name
    if menu_item("Set to current view", help_of("Set view to current")):
        views.save(name)
    if menu_item("Rename", help_of("Rename view")):
        views.begin_renaming(name)
    at = [view.name for view in views.views].index(name)
    if menu_item("Move up", "Move the view up in the list.", possible=at > 0):
        views.move(name, -1)
    if menu_item("Move down", "Move the view down in the list.", possible=at + 1 < len(views.views)):
        views.move(name, 1)
    imgui.separator()
    if menu_item(f"{_DELETE} Delete###delete", help_of("Delete view")):
        views.remove(name)
