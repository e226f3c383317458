"""Layers panel: visibility, locks, names, order and merging of layers and actors, and color grading."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.edits import layers
from gsrain_engine.editor.edits.members import (
    keys_of,
    members_title,
    set_grading,
    set_locked,
    set_opacity,
    set_visible,
)
from gsrain_engine.editor.files import Files
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.fields import Field
from gsrain_engine.scene.scene import UNCHANGED, Actor, ColorGrading, Layer, Scene
from gsrain_engine.scene.transforms import without_wet_colors

from ..commands.actions import duplicate_members
from ..commands.keys import chord
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
_ALSO_CHOSEN = 0.5  # opacity of the rows that are chosen besides the active one
_ALL_KEYS = chord(imgui.Key.mod_ctrl, imgui.Key.a)


@dataclass(slots=True)
class _PanelState:
    renamed: str = ""
    """Key of the layer or actor that is being renamed."""
    typed: str = ""
    is_new: bool = False


_state = _PanelState()


def layers_panel(document: Document, viewport: ViewportState, files: Files) -> None:
    scene = document.scene
    imgui.text_wrapped(f"{files.title}: {scene.gaussian_count:,} Gaussians")
    _choose_all_by_key(viewport)
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
    if viewport.active_member is not None:
        opacity_field(document, viewport)
    else:
        with text_color(imgui.Col_.text_disabled):
            imgui.text_wrapped("Click a name to edit that layer or actor; Ctrl+click adds one, Shift+click a range.")
    _buttons(document, viewport)


def _choose_all_by_key(viewport: ViewportState) -> None:
    """Choose all rows by Ctrl+A while the list has the focus; elsewhere the key selects Gaussians."""
    if imgui.is_window_focused(imgui.FocusedFlags_.child_windows) and not imgui.get_io().want_text_input:
        imgui.internal.set_key_owner(imgui.Key.a, imgui.get_id("rows"))
        if imgui.is_key_chord_pressed(_ALL_KEYS):
            viewport.choose_all()


def _row(document: Document, viewport: ViewportState, member: Layer | Actor) -> None:
    key = member.key
    chosen = viewport.chosen_members
    members = chosen if member in chosen else [member]  # those on which a click into this row acts
    imgui.table_next_row()
    imgui.table_next_column()
    eye = _ICONS.ICON_FA_EYE if member.visible else _ICONS.ICON_FA_EYE_SLASH
    if _icon(eye, f"show {key}", "Show or hide.", bright=member.visible):
        verb = "Hide" if member.visible else "Show"
        document.edit(f"{verb} {members_title(members)}", set_visible, keys_of(members), not member.visible)
    imgui.table_next_column()
    lock = _ICONS.ICON_FA_LOCK if member.locked else _ICONS.ICON_FA_LOCK_OPEN
    if _icon(lock, f"lock {key}", "Protect from selection and edits.", bright=member.locked):
        verb = "Unlock" if member.locked else "Lock"
        document.edit(f"{verb} {members_title(members)}", set_locked, keys_of(members), not member.locked)
    imgui.table_next_column()
    if _state.renamed == key:
        _rename(document, viewport, member)
    else:
        _name(document, viewport, member, is_chosen=member in chosen)
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


def _name(document: Document, viewport: ViewportState, member: Layer | Actor, *, is_chosen: bool) -> None:
    key = member.key
    drop = "" if member.wet_sh is None else f" {_ICONS.ICON_FA_DROPLET}"
    words = f"{visible_name(member.name)}{drop}###{plain_identity(key.replace('/', ' '))}"
    imgui.align_text_to_frame_padding()
    color = imgui.get_style_color_vec4(imgui.Col_.header)
    faded = 1.0 if viewport.options.member == key else _ALSO_CHOSEN
    imgui.push_style_color(imgui.Col_.header, (color.x, color.y, color.z, faded * color.w))
    clicked, _ = imgui.selectable(words, is_chosen, imgui.SelectableFlags_.allow_double_click)
    imgui.pop_style_color()
    kind = f"actor, {member.class_name}" if isinstance(member, Actor) else member.kind
    wet = "" if member.wet_sh is None else " Has wet colors, blended in by the wetness of the Rain panel."
    imgui.set_item_tooltip(
        f"{member.name}: {kind}.{wet} Double click: rename. Right click: menu.\n"
        "Ctrl+click: choose one more, or one less. Shift+click: all between. Ctrl+A: all."
    )
    io = imgui.get_io()
    if clicked and io.key_shift:
        viewport.choose_range(key, adds=io.key_ctrl)
    elif clicked and io.key_ctrl:
        viewport.choose_also(key)
    elif clicked:
        viewport.choose(key)
        if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            _begin_naming(member)
    if imgui.begin_popup_context_item():
        viewport.options.member = key
        _menu(document, viewport, member)
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
        viewport.choose(next((each.key for each in document.scene.members if each.key not in names), member.key))
    if entered or (imgui.is_item_deactivated() and not _state.is_new):
        _state.renamed = ""
    _state.is_new = False


def _menu(document: Document, viewport: ViewportState, member: Layer | Actor) -> None:
    """Draw the menu of a row: copies and removes all that are chosen, and changes the row itself."""

    def item(title: str, label: str, change: Callable[..., Scene], enabled: bool = True) -> None:
        if imgui.menu_item(title, "", False, enabled)[0]:
            document.edit(label, change, member.key)

    if imgui.menu_item("Rename", "", False)[0]:
        _begin_naming(member)
    if imgui.menu_item("Duplicate", "", False)[0]:
        duplicate_members(document, viewport)
    item("Move up", f"Move {member.name} up", layers.move_up)
    item("Move down", f"Move {member.name} down", layers.move_down)
    imgui.separator()
    is_wet = member.wet_sh is not None and not member.locked
    item("Remove wet colors", f"Remove wet colors of {member.name}", without_wet_colors, is_wet)
    if imgui.menu_item("Remove", "", False, bool(_unlocked(viewport)))[0]:
        _remove(document, viewport)


def _unlocked(viewport: ViewportState) -> list[Layer | Actor]:
    """Return the chosen layers and actors that may be edited."""
    return [each for each in viewport.chosen_members if not each.locked]


def _remove(document: Document, viewport: ViewportState) -> None:
    members = _unlocked(viewport)
    document.edit(f"Remove {members_title(members)}", layers.remove, keys_of(members))


def _buttons(document: Document, viewport: ViewportState) -> None:
    chosen, merged = viewport.chosen_members, [each.key for each in viewport.chosen_members if isinstance(each, Layer)]
    is_selected = any(each.marks.selected for each in document.scene.members)
    half = share_of_width(2)
    help_text = "Copy the chosen layers and actors under new names; copies take no more memory."
    if button("Duplicate", help_text, width=half, enabled=bool(chosen)):
        duplicate_members(document, viewport)
    imgui.same_line()
    help_text = "Remove the chosen layers and actors from the scene, but for locked ones; undo restores them."
    if button("Remove", help_text, width=half, enabled=bool(_unlocked(viewport))):
        _remove(document, viewport)
    if button("Separate", "Move the selection to a new layer.", width=half, enabled=is_selected):
        document.edit("Separate selection", layers.separate)
    imgui.same_line()
    help_text = "Join the chosen layers (Ctrl+click) into the one that was chosen first."
    if button("Merge", help_text, width=half, enabled=len(merged) > 1):
        document.edit(f"Merge {len(merged)} layers", layers.merge, merged)


# Opacity and color grading: of all that are chosen and not locked


def grading_fields(document: Document, viewport: ViewportState) -> None:
    """Edit opacity and color grading of what is chosen; a value that differs among them is replaced by one for all."""
    opacity_field(document, viewport)
    members = _edited(viewport)
    keys, title = keys_of(members), members_title(members)
    for name in ColorGrading.__struct_fields__:
        info = field_label(name, ColorGrading)

        def change(value: float, name: str = name, info: Field = info) -> None:
            words = f"{info.title} of {title}: {value:.2f} {info.unit}".rstrip()
            document.edit(words, set_grading, keys, gesture=f"{name} {keys}", **{name: value})

        values = [getattr(each.grading, name) for each in members]
        with disabled(not _unlocked(viewport)):
            _slider(document, name, values, info.low, info.high, getattr(UNCHANGED, name), change)
    is_graded = any(each.grading != UNCHANGED for each in _unlocked(viewport))
    if button("Reset colors", "Reset the color grading; opacity does not change.", width=-1, enabled=is_graded):
        document.edit(f"Reset colors of {title}", set_grading, keys, UNCHANGED)


def opacity_field(document: Document, viewport: ViewportState) -> None:
    members = _edited(viewport)
    keys, title = keys_of(members), members_title(members)

    def change(value: float) -> None:
        document.edit(f"Opacity of {title}: {value:.2f}", set_opacity, keys, value, gesture=f"opacity {keys}")

    plain_label("Opacity", f"Multiplies the opacity of every Gaussian of {title}.")
    with disabled(not _unlocked(viewport)):
        _slider(document, "opacity", [each.opacity for each in members], 0.0, 1.0, 1.0, change)


def _edited(viewport: ViewportState) -> list[Layer | Actor]:
    """Return what an edit of the chosen ones changes, the active one last; all of them where all are locked."""
    active = viewport.active_member
    members = _unlocked(viewport) or viewport.chosen_members
    return sorted(members, key=lambda each: each is active)


def _slider(
    document: Document, name: str, values: Sequence[float], low: float, high: float, default: float,
    change: Callable[[float], None],
) -> None:  # fmt: skip
    """Draw a slider of one value of several layers, at that of the last, and a reset button; both call `change`.

    Values that are not all equal are displayed as "differing".
    """
    side, gap = imgui.get_frame_height(), imgui.get_style().item_inner_spacing.x
    value, form = values[-1], "%.2f"
    if len(set(values)) > 1:  # a hair off, so that typing the value of the last one sets it for all
        value, form = value + (high - low) * (1e-6 if value < default else -1e-6), "differing"
    imgui.set_next_item_width(-side - gap)
    changed, new = slide(f"##{name}", value, low, high, form)
    if changed:
        change(new)
    end_gesture_when_released(document)
    imgui.same_line(0, gap)
    title = f"{_ICONS.ICON_FA_ROTATE_LEFT}##reset {name}"
    is_other = any(each != default for each in values)
    if button(title, f"Reset to {default:g}.", width=side, height=side, enabled=is_other):
        change(default)
        document.end_gesture()
