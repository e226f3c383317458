"""Layers panel: visibility, locks, names, order and merging of layers and actors, and color grading."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import msgspec
from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits import layers
from gsrain_engine.scene.scene import UNCHANGED, Actor, ColorGrading, Layer
from gsrain_engine.scene.transforms import without_wet_colors

from ..widgets.fields import end_gesture_when_released, field_info, plain_label
from ..widgets.text import plain_identity, visible_name

_ICONS = icons_fontawesome_6
_ICON_EM = 1.3


@dataclass(slots=True)
class _Naming:
    """Layer or actor being renamed, and the typed name."""

    key: str = ""
    typed: str = ""
    is_new: bool = False


@dataclass(slots=True)
class _Marked:
    """Layers to merge, chosen with Ctrl."""

    keys: list[str] = field(default_factory=list[str])


_naming, _marked = _Naming(), _Marked()


def layers_panel(session: Editor) -> None:
    scene = session.scene
    imgui.text_wrapped(f"{scene.name}: {scene.gaussian_count:,} Gaussians")
    _marked.keys = [key for key in _marked.keys if any(each.key == key for each in scene.members)]
    flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_fixed_fit
    if imgui.begin_table("members", 4, flags):
        icon = _ICON_EM * imgui.get_font_size()
        imgui.table_setup_column("shown", imgui.TableColumnFlags_.width_fixed, icon)
        imgui.table_setup_column("locked", imgui.TableColumnFlags_.width_fixed, icon)
        imgui.table_setup_column("name", imgui.TableColumnFlags_.width_stretch)
        imgui.table_setup_column("count", imgui.TableColumnFlags_.width_fixed)
        for title, members in (("Layers", scene.layers), ("Actors", scene.actors)):
            _group(session, title, members)
        imgui.end_table()
    _opacity(session)
    _buttons(session)


def _group(session: Editor, title: str, members: Sequence[Layer | Actor]) -> None:
    if not members:
        return
    imgui.table_next_row()
    imgui.table_set_column_index(0)
    flags = imgui.TreeNodeFlags_.default_open | imgui.TreeNodeFlags_.no_tree_push_on_open
    is_open = imgui.tree_node_ex(title, flags | imgui.TreeNodeFlags_.label_span_all_columns)
    if is_open:
        for member in members:
            _row(session, member)


def _row(session: Editor, member: Layer | Actor) -> None:
    key = member.key
    imgui.table_next_row()
    imgui.table_next_column()
    eye = _ICONS.ICON_FA_EYE if member.visible else _ICONS.ICON_FA_EYE_SLASH
    if _icon(eye, f"show {key}", "Show or hide.", bright=member.visible):
        session.show_member(key, not member.visible)
    imgui.table_next_column()
    lock = _ICONS.ICON_FA_LOCK if member.locked else _ICONS.ICON_FA_LOCK_OPEN
    if _icon(lock, f"lock {key}", "Keep selection and edits away from it.", bright=member.locked):
        verb = "Unlock" if member.locked else "Lock"
        session.set_scene(f"{verb} {member.name}", session.scene.with_member(key, locked=not member.locked))
    imgui.table_next_column()
    if _naming.key == key:
        _rename(session, member)
    else:
        _name(session, member)
    imgui.table_next_column()
    deleted = member.marks.deleted.size if member.marks.deleted is not None else 0
    imgui.text_disabled(f"{len(member.gaussians) - deleted:,}")
    if deleted:
        imgui.set_item_tooltip(f"{deleted:,} more are deleted; they stay in the scene folder for undo.")


def _icon(icon: str, name: str, help_text: str, *, bright: bool) -> bool:
    color = imgui.Col_.text if bright else imgui.Col_.text_disabled
    imgui.push_style_color(imgui.Col_.text, imgui.get_style_color_vec4(color))
    imgui.push_style_color(imgui.Col_.button, (0.0, 0.0, 0.0, 0.0))
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(1, imgui.get_style().frame_padding.y))
    imgui.push_style_var(imgui.StyleVar_.frame_border_size, 0.0)
    clicked = imgui.button(
        f"{icon}###{plain_identity(name.replace('/', ' '))}", ImVec2(_ICON_EM * imgui.get_font_size(), 0)
    )
    imgui.pop_style_var(2)
    imgui.pop_style_color(2)
    imgui.set_item_tooltip(help_text)
    return clicked


def _name(session: Editor, member: Layer | Actor) -> None:
    key = member.key
    is_chosen = session.view.member == key or key in _marked.keys
    drop = "" if member.wet_sh is None else f" {_ICONS.ICON_FA_DROPLET}"
    words = f"{visible_name(member.name)}{drop}###{plain_identity(key.replace('/', ' '))}"
    imgui.align_text_to_frame_padding()
    clicked, _ = imgui.selectable(words, is_chosen, imgui.SelectableFlags_.allow_double_click)
    kind = f"actor, {member.class_name}" if isinstance(member, Actor) else member.kind
    wet = "" if member.wet_sh is None else " Has wet colours, which come with the wetness of the Rain panel."
    imgui.set_item_tooltip(
        f"{member.name}: {kind}.{wet} Double click renames; right click for more; Ctrl marks several to merge."
    )
    if clicked and imgui.get_io().key_ctrl:
        _marked.keys = [each for each in _marked.keys if each != key] if key in _marked.keys else [*_marked.keys, key]
    elif clicked:
        session.view.member, _marked.keys = key, [key]
        if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            _begin_naming(member)
    if imgui.begin_popup_context_item():
        session.view.member = key
        _menu(session, member)
        imgui.end_popup()


def _begin_naming(member: Layer | Actor) -> None:
    _naming.key, _naming.typed, _naming.is_new = member.key, member.name, True


def _rename(session: Editor, member: Layer | Actor) -> None:
    imgui.set_next_item_width(-1)
    if _naming.is_new:
        imgui.set_keyboard_focus_here()
    flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
    entered, _naming.typed = imgui.input_text("##new name", _naming.typed, flags)
    if entered and _naming.typed.strip() not in ("", member.name):
        names = {each.key for each in session.scene.members}
        session.edit(f"Rename {member.name}", layers.rename, member.key, _naming.typed)
        session.view.member = next((each.key for each in session.scene.members if each.key not in names), member.key)
    if entered or (imgui.is_item_deactivated() and not _naming.is_new):
        _naming.key = ""
    _naming.is_new = False


def _menu(session: Editor, member: Layer | Actor) -> None:
    key, name = member.key, member.name
    if imgui.menu_item("Rename", "", False)[0]:
        _begin_naming(member)
    if imgui.menu_item("Duplicate", "", False)[0]:
        session.edit(f"Duplicate {name}", layers.duplicate, key)
    if imgui.menu_item("Move up", "", False)[0]:
        session.edit(f"Move {name} up", layers.move_up, key)
    if imgui.menu_item("Move down", "", False)[0]:
        session.edit(f"Move {name} down", layers.move_down, key)
    imgui.separator()
    if imgui.menu_item("Remove wet colours", "", False, member.wet_sh is not None and not member.locked)[0]:
        session.edit(f"Remove wet colours of {name}", without_wet_colors, key)
    if imgui.menu_item("Remove", "", False, not member.locked)[0]:
        session.edit(f"Remove {name}", layers.remove, key)


def _opacity(session: Editor) -> None:
    chosen = next((each for each in session.scene.members if each.key == session.view.member), None)
    if chosen is None:
        imgui.push_style_color(imgui.Col_.text, imgui.get_style_color_vec4(imgui.Col_.text_disabled))
        imgui.text_wrapped("Click a name to work on that layer or actor.")
        imgui.pop_style_color()
        return
    plain_label("Opacity", f"Of {chosen.name} as a whole; 1 leaves every Gaussian its own.")
    imgui.begin_disabled(chosen.locked)
    changed, value = imgui.slider_float("##opacity", chosen.opacity, 0, 1, "%.2f", imgui.SliderFlags_.always_clamp)
    imgui.end_disabled()
    if changed:
        label = f"Opacity of {chosen.name}"
        session.set_scene(label, session.scene.with_member(chosen.key, opacity=value), f"opacity {chosen.key}")
    end_gesture_when_released(session)


def _buttons(session: Editor) -> None:
    chosen = next((each for each in session.scene.members if each.key == session.view.member), None)
    marked = [key for key in _marked.keys if key.startswith("layers/")]
    is_selected = any(each.marks.selected for each in session.scene.members)
    wide = ImVec2((imgui.get_content_region_avail().x - imgui.get_style().item_spacing.x) / 2, 0)
    imgui.begin_disabled(chosen is None)
    if imgui.button("Duplicate", wide) and chosen is not None:
        session.edit(f"Duplicate {chosen.name}", layers.duplicate, chosen.key)
    imgui.set_item_tooltip("A copy under a name of its own; it shares the arrays.")
    imgui.same_line()
    imgui.begin_disabled(chosen is not None and chosen.locked)
    if imgui.button("Remove", wide) and chosen is not None:
        session.edit(f"Remove {chosen.name}", layers.remove, chosen.key)
    imgui.set_item_tooltip("Take it out of the scene; undo brings it back.")
    imgui.end_disabled()
    imgui.end_disabled()
    imgui.begin_disabled(not is_selected)
    if imgui.button("Separate", wide):
        session.edit("Separate the selection", layers.separate)
    imgui.set_item_tooltip("Make the selection a layer of its own.")
    imgui.end_disabled()
    imgui.same_line()
    imgui.begin_disabled(len(marked) < 2)
    if imgui.button("Merge", wide):
        session.edit(f"Merge {len(marked)} layers", layers.merge, marked)
    imgui.set_item_tooltip("Join the layers that are marked (Ctrl+click) into the first one.")
    imgui.end_disabled()


# Opacity and color grading

_RESET = icons_fontawesome_6.ICON_FA_ROTATE_LEFT


def grading_fields(session: Editor, member: Layer | Actor) -> None:
    plain_label("Opacity", f"Multiplies that of every Gaussian of {member.name}; 1 leaves it.")
    changed, value = _slider("opacity", member.opacity, 0.0, 1.0, 1.0)
    if changed:
        session.set_scene(
            f"Opacity of {member.name}",
            session.scene.with_member(member.key, opacity=value),
            gesture=f"opacity {member.key}",
        )
    end_gesture_when_released(session)
    for name in ColorGrading.__struct_fields__:
        info = field_info(name, ColorGrading)
        plain_label(f"{info.title} ({info.unit})" if info.unit else info.title, info.help)
        changed, value = _slider(name, getattr(member.grading, name), info.low, info.high, getattr(UNCHANGED, name))
        if changed:
            _grade(session, member, info.title, msgspec.structs.replace(member.grading, **{name: value}))
        end_gesture_when_released(session)
    imgui.begin_disabled(member.grading == UNCHANGED)
    if imgui.button("Reset colours", (-1, 0)):
        _grade(session, member, "Reset colours", UNCHANGED)
        session.end_gesture()
    imgui.end_disabled()
    imgui.set_item_tooltip("Take the grading back; opacity stays.")


def _grade(session: Editor, member: Layer | Actor, what: str, grading: ColorGrading) -> None:
    scene = session.scene.with_member(member.key, grading=grading)
    session.set_scene(f"{what} of {member.name}", scene, gesture=f"{what} {member.key}")


def _slider(name: str, value: float, low: float, high: float, rest: float) -> tuple[bool, float]:
    """Return whether slider or reset button changed the value, and the value."""
    side = imgui.get_frame_height()
    imgui.set_next_item_width(-side - imgui.get_style().item_inner_spacing.x)
    changed, slid = imgui.slider_float(f"##{name}", value, low, high, "%.2f", imgui.SliderFlags_.always_clamp)
    imgui.same_line(0, imgui.get_style().item_inner_spacing.x)
    imgui.begin_disabled(value == rest)
    is_reset = imgui.button(f"{_RESET}##reset {name}", (side, side))
    imgui.end_disabled()
    imgui.set_item_tooltip(f"Back to {rest:g}.")
    return (changed or is_reset), rest if is_reset else slid
