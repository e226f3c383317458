"""Display panel and Statistics panel."""

import math
import time
from typing import get_args

from imgui_bundle import imgui

from gsrain_engine.choices import Mark
from gsrain_engine.editor.preferences import Preferences, PreferencesStore
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.render.opengl.buffers import Harmonics

from ..commands.table import help_of
from ..widgets.fields import combo, disabled, edit_field, faint, field_label, number, plain_label, warning_color
from ..widgets.numbers import slide
from ..widgets.text import readings

_STORAGES: dict[Harmonics, str] = {"single": "32 bits", "half": "16 bits", "byte": "8 bits"}
_SHRINKS = {1: "100 %", 2: "50 %", 3: "33 %"}
_MIN_TARGET_MS, _MAX_TARGET_MS, _TARGET_STEP_MS = 10.0, 200.0, 5.0
_dragged: dict[str, float] = {}  # values of sliders that are being dragged, by preference


def display_panel(viewport: ViewportState, preferences: PreferencesStore) -> None:
    view, budget, navigation = viewport.options, viewport.budget, viewport.navigation
    plain_label("Resolution", "Draw fewer pixels while tuning; the rain has the same drops.")
    view.shrink = combo("##resolution", view.shrink, _SHRINKS)
    plain_label("While moving", "Draw less while the camera moves or rain plays, to hold this time; exact at rest.")
    _, budget.enabled = imgui.checkbox("##budget", budget.enabled)
    imgui.same_line()
    imgui.set_next_item_width(-1)
    shortest_ms = max(_MIN_TARGET_MS, _TARGET_STEP_MS * math.ceil(budget.min_target_ms / _TARGET_STEP_MS))
    with disabled(not budget.enabled):
        bounds = shortest_ms, max(_MAX_TARGET_MS, 2 * shortest_ms)
        shown_ms = max(budget.target_ms, shortest_ms)
        changed, target_ms = slide("##target_ms", shown_ms, *bounds, "%.0f ms per frame", unit="ms")
        budget.target_ms = target_ms if changed else budget.target_ms
    if shortest_ms > _MIN_TARGET_MS:
        faint(f"Shortest time kept here: {shortest_ms:.0f} ms, by the coarsest pictures.")
    fov = number(
        "Vertical FOV (deg)", "fov", navigation.vertical_fov_deg, 15, 110, "%.0f\u00b0", "Vertical field of view."
    )
    navigation.vertical_fov_deg = fov
    plain_label("Orthographic", help_of("Orthographic view"))
    _, view.orthographic = imgui.checkbox("##orthographic", view.orthographic)
    plain_label("Marks", "Lines over an orthographic view, and over images of it that are rendered.")
    left = imgui.get_cursor_pos_x()
    with disabled(not view.orthographic):
        for place, mark in enumerate(get_args(Mark)):
            if place % 2:
                imgui.same_line()
            else:
                imgui.set_cursor_pos_x(left)
            changed, is_on = imgui.checkbox(mark.capitalize(), mark in view.marks)
            if changed:
                view.marks = view.marks | {mark} if is_on else view.marks - {mark}
    help_text = "Brightens or darkens the display only, not the scene."
    view.gain_ev = number("Display gain (EV)", "gain", view.gain_ev, -3, 3, "%.1f", help_text)
    plain_label("Background", "Color of pixels without Gaussians.")
    _, color = imgui.color_edit3("##background", list(view.background))
    view.background = (color[0], color[1], color[2])
    plain_label(
        "Color precision",
        "Of colors on the GPU: fewer bits take less memory and, in large scenes, less time per frame.",
    )
    with disabled(not viewport.backend.startswith("opengl")):
        view.harmonics = combo("##harmonics", view.harmonics, _STORAGES)
    imgui.separator_text("Window")
    if (changed := edit_field(preferences.value, "theme")) is not preferences.value:
        preferences.set(theme=changed.theme)
    for name, form in (("font_scale", "%.2f"), ("ui_scale", "%.2f"), ("autosave_s", "%.0f")):
        # It applies when the slider is released, so that the layout doesn't change during the drag.
        info, present = field_label(name, Preferences), _dragged.get(name, getattr(preferences.value, name))
        changed, value = slide(f"##{name}", present, info.low, info.high, form, unit=info.unit)
        if changed:
            _dragged[name] = value
        if imgui.is_item_deactivated_after_edit() and name in _dragged:
            preferences.set(**{name: _dragged.pop(name)})
    if (changed := edit_field(preferences.value, "desktop_dialogs")) is not preferences.value:
        preferences.set(desktop_dialogs=changed.desktop_dialogs)


def statistics_panel(viewport: ViewportState) -> None:
    imgui.text_wrapped(f"{viewport.rate.words(time.perf_counter())}, back end: {viewport.backend}".lstrip(", "))
    if viewport.backend_reason:
        imgui.text_disabled(viewport.backend_reason)
    if viewport.detail.is_exact:
        imgui.text_disabled("full quality")
    else:
        imgui.text_colored(warning_color(), f"while something moves: {viewport.detail}")
    rows = [
        (
            f"{name[0].upper()}{name[1:]}".replace(" ms", " (ms)"),
            f"{value:,.{0 if float(value).is_integer() else 2}f}",
            "Of the last frame.",
        )
        for name, value in viewport.statistics.items()
    ]
    readings("statistics", rows)
