"""Layers panel: visibility, locks, names, order and merging of layers and actors, and color grading."""

from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.edits import layers
from gsrain_engine.editor.edits.members import set_grading, set_locked, set_opacity, set_visible
from gsrain_engine.editor.files import Files
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.scene.scene import UNCHANGED, Actor, ColorGrading, Layer, Scene
from gsrain_engine.scene.transforms import without_wet_colors

from ..widgets.fields import (
    button,
    disabled,
    end_gesture_when_released,
    field_label,
    plain_label,
    share_of_width,
    text_color,
)
from ..widgets.numbers import slide
from ..widgets.text import plain_identity, visible_name

_ICONS = icons_fontawesome_6
_ICON_EM = 1.3


@dataclass(slots=True)
class _PanelState:
    renamed: str = ""
    """Key of the layer or actor that is being renamed."""
    typed: str = ""
    is_new: bool = False
    marked: list[str] = field(default_factory=list[str])
    """Keys of the layers to merge, chosen with Ctrl."""


_state = _PanelState()


def layers_panel(document: Document, viewport: ViewportState, files: Files) -> None:
    scene = document.scene
    chosen = next((each for each in scene.members if each.key == viewport.options.member), None)
    imgui.text_wrapped(f"{files.title}: {scene.gaussian_count:,} Gaussians")
    _state.marked = [key for key in _state.marked if any(each.key == key for each in scene.members)]
    if imgui.begin_table("members", 4, imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_fixed_fit):
        icon = _ICON_EM * imgui.get_font_size()
        imgui.push_text_wrap_pos(-1.0)  # columns fit their words
        imgui.table_setup_column("shown", imgui.TableColumnFlags_.width_fixed, icon)
        imgui.table_setup_column("locked", imgui.TableColumnFlags_.width_fixed, icon)
        imgui.table_setup_column("name", imgui.TableColumnFlags_.width_stretch)
        imgui.table_setup_column("count", imgui.TableColumnFlags_.width_fixed)
        for title, members in (("Layers", scene.layers), ("Actors", scene.actors)):
            if members:
                imgui.table_next_row()
                imgui.table_set_column_index(0)
                flags = imgui.TreeNodeFlags_.default_open | imgui.TreeNodeFlags_.no_tree_push_on_open
                is_open = imgui.tree_node_ex(title, flags | imgui.TreeNodeFlags_.label_span_all_columns)
                for member in members if is_open else ():
                    _row(document, viewport, member)
        imgui.pop_text_wrap_pos()
        imgui.end_table()
    if chosen is not None:
        _opacity(document, chosen)
    else:
        with text_color(imgui.Col_.text_disabled):
            imgui.text_wrapped("Click a name to edit that layer or actor.")
    _buttons(document, chosen)


def _row(document: Document, viewport: ViewportState, member: Layer | Actor) -> None:
    key = member.key
    imgui.table_next_row()
    imgui.table_next_column()
    eye = _ICONS.ICON_FA_EYE if member.visible else _ICONS.ICON_FA_EYE_SLASH
    if _icon(eye, f"show {key}", "Show or hide.", bright=member.visible):
        document.edit(f"{'Hide' if member.visible else 'Show'} {member.name}", set_visible, key, not member.visible)
    imgui.table_next_column()
    lock = _ICONS.ICON_FA_LOCK if member.locked else _ICONS.ICON_FA_LOCK_OPEN
    if _icon(lock, f"lock {key}", "Protect from selection and edits.", bright=member.locked):
        verb = "Unlock" if member.locked else "Lock"
        document.edit(f"{verb} {member.name}", set_locked, key, not member.locked)
    imgui.table_next_column()
    if _state.renamed == key:
        _rename(document, viewport, member)
    else:
        _name(document, viewport, member)
    imgui.table_next_column()
    deleted = member.marks.deleted.size if member.marks.deleted is not None else 0
    words = f"{len(member.gaussians) - deleted:,}"
    room = imgui.get_content_region_avail().x - imgui.calc_text_size(words).x
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(room, 0.0))
    imgui.text_disabled(words)
    if deleted:
        imgui.set_item_tooltip(
            f"{deleted:,} more were deleted, cropped or separated; the scene folder has them for undo until a purge."
        )


def _icon(icon: str, name: str, help_text: str, *, bright: bool) -> bool:
    imgui.push_style_color(imgui.Col_.button, (0.0, 0.0, 0.0, 0.0))
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(1, imgui.get_style().frame_padding.y))
    imgui.push_style_var(imgui.StyleVar_.frame_border_size, 0.0)
    with text_color(imgui.Col_.text if bright else imgui.Col_.text_disabled):
        identity = plain_identity(name.replace("/", " "))
        clicked = imgui.button(f"{icon}###{identity}", ImVec2(_ICON_EM * imgui.get_font_size(), 0))
    imgui.pop_style_var(2)
    imgui.pop_style_color()
    imgui.set_item_tooltip(help_text)
    return clicked


def _name(document: Document, viewport: ViewportState, member: Layer | Actor) -> None:
    key, marked = member.key, _state.marked
    drop = "" if member.wet_sh is None else f" {_ICONS.ICON_FA_DROPLET}"
    words = f"{visible_name(member.name)}{drop}###{plain_identity(key.replace('/', ' '))}"
    imgui.align_text_to_frame_padding()
    is_chosen = viewport.options.member == key or key in marked
    clicked, _ = imgui.selectable(words, is_chosen, imgui.SelectableFlags_.allow_double_click)
    kind = f"actor, {member.class_name}" if isinstance(member, Actor) else member.kind
    wet = "" if member.wet_sh is None else " Has wet colors, blended in by the wetness of the Rain panel."
    imgui.set_item_tooltip(
        f"{member.name}: {kind}.{wet} Double click: rename. Right click: menu. Ctrl+click: mark several to merge."
    )
    if clicked and imgui.get_io().key_ctrl:
        _state.marked = [each for each in marked if each != key] if key in marked else [*marked, key]
    elif clicked:
        viewport.options.member, _state.marked = key, [key]
        if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            _begin_naming(member)
    if imgui.begin_popup_context_item():
        viewport.options.member = key
        _menu(document, member)
        imgui.end_popup()


def _begin_naming(member: Layer | Actor) -> None:
    _state.renamed, _state.typed, _state.is_new = member.key, member.name, True


def _rename(document: Document, viewport: ViewportState, member: Layer | Actor) -> None:
    imgui.set_next_item_width(-1)
    if _state.is_new:
        imgui.set_keyboard_focus_here()
    flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
    entered, _state.typed = imgui.input_text("##new name", _state.typed, flags)
    if entered and _state.typed.strip() not in ("", member.name):
        names = {each.key for each in document.scene.members}
        document.edit(f"Rename {member.name} to {_state.typed.strip()}", layers.rename, member.key, _state.typed)
        viewport.options.member = next(
            (each.key for each in document.scene.members if each.key not in names), member.key
        )
    if entered or (imgui.is_item_deactivated() and not _state.is_new):
        _state.renamed = ""
    _state.is_new = False


def _menu(document: Document, member: Layer | Actor) -> None:
    def item(title: str, label: str, change: Callable[..., Scene], enabled: bool = True) -> None:
        if imgui.menu_item(title, "", False, enabled)[0]:
            document.edit(label, change, member.key)

    if imgui.menu_item("Rename", "", False)[0]:
        _begin_naming(member)
    item("Duplicate", f"Duplicate {member.name}", layers.duplicate)
    item("Move up", f"Move {member.name} up", layers.move_up)
    item("Move down", f"Move {member.name} down", layers.move_down)
    imgui.separator()
    is_wet = member.wet_sh is not None and not member.locked
    item("Remove wet colors", f"Remove wet colors of {member.name}", without_wet_colors, is_wet)
    item("Remove", f"Remove {member.name}", layers.remove, not member.locked)


def _opacity(document: Document, member: Layer | Actor) -> None:
    plain_label("Opacity", f"Multiplies the opacity of every Gaussian of {member.name}.")
    with disabled(member.locked):
        changed, value = slide("##opacity", member.opacity, 0, 1, "%.2f")
    _set_opacity(document, member, value if changed else member.opacity)


def _set_opacity(document: Document, member: Layer | Actor, value: float) -> None:
    if value != member.opacity:
        gesture = f"opacity {member.key}"
        document.edit(f"Opacity of {member.name}", set_opacity, member.key, value, gesture=gesture)
    end_gesture_when_released(document)


def _buttons(document: Document, chosen: Layer | Actor | None) -> None:
    marked = [key for key in _state.marked if key.startswith("layers/")]
    is_selected = any(each.marks.selected for each in document.scene.members)
    half, is_free = share_of_width(2), chosen is not None and not chosen.locked
    help_text = "Copy the chosen layer or actor under a new name; the copy takes no more memory."
    if button("Duplicate", help_text, width=half, enabled=chosen is not None) and chosen is not None:
        document.edit(f"Duplicate {chosen.name}", layers.duplicate, chosen.key)
    imgui.same_line()
    help_text = "Remove the chosen layer or actor from the scene; undo restores it."
    if button("Remove", help_text, width=half, enabled=is_free) and chosen is not None:
        document.edit(f"Remove {chosen.name}", layers.remove, chosen.key)
    if button("Separate", "Move the selection to a new layer.", width=half, enabled=is_selected):
        document.edit("Separate selection", layers.separate)
    imgui.same_line()
    help_text = "Join the marked layers (Ctrl+click) into the first one."
    if button("Merge", help_text, width=half, enabled=len(marked) > 1):
        document.edit(f"Merge {len(marked)} layers", layers.merge, marked)


# Opacity and color grading


def grading_fields(document: Document, member: Layer | Actor) -> None:
    plain_label("Opacity", f"Multiplies the opacity of every Gaussian of {member.name}.")
    _set_opacity(document, member, _slider("opacity", member.opacity, 0.0, 1.0, 1.0))
    for name in ColorGrading.__struct_fields__:
        info, present = field_label(name, ColorGrading), getattr(member.grading, name)
        value = _slider(name, present, info.low, info.high, getattr(UNCHANGED, name))
        if value != present:
            _grade(document, member, info.title, msgspec.structs.replace(member.grading, **{name: value}))
        end_gesture_when_released(document)
    help_text = "Reset the color grading; opacity does not change."
    if button("Reset colors", help_text, width=-1, enabled=member.grading != UNCHANGED):
        _grade(document, member, "Reset colors", UNCHANGED)
        document.end_gesture()


def _grade(document: Document, member: Layer | Actor, what: str, grading: ColorGrading) -> None:
    document.edit(f"{what} of {member.name}", set_grading, member.key, grading, gesture=f"{what} {member.key}")


def _slider(name: str, value: float, low: float, high: float, default: float) -> float:
    """Draw a slider and a reset button; returns the new value."""
    side, gap = imgui.get_frame_height(), imgui.get_style().item_inner_spacing.x
    imgui.set_next_item_width(-side - gap)
    changed, new = slide(f"##{name}", value, low, high, "%.2f")
    imgui.same_line(0, gap)
    title = f"{_ICONS.ICON_FA_ROTATE_LEFT}##reset {name}"
    if button(title, f"Reset to {default:g}.", width=side, height=side, enabled=value != default):
        return default
    return new if changed else value
