"""The Display panel: how the viewport shows things."""

from imgui_bundle import imgui

from gsrain_engine.render.gpu_arrays import Harmonics
from gsrain_engine.session.session import Session

from ..widgets.fields import plain_label

_STORAGES: dict[Harmonics, str] = {"single": "32 bits", "half": "16 bits", "byte": "8 bits"}


_held: dict[str, float] = {}
"""Sliders that are being dragged, by the preference they are of."""


def display_panel(session: Session) -> None:
    view = session.view
    plain_label("Background", "Shown where the scene has nothing.")
    _, color = imgui.color_edit3("##background", list(view.background))
    view.background = (color[0], color[1], color[2])
    plain_label("Display gain (EV)", "Brightens or darkens the display only, not the scene.")
    _, view.gain_ev = imgui.slider_float("##gain", view.gain_ev, -3, 3, "%.1f")
    plain_label("Resolution", "Draw fewer pixels while tuning; the rain keeps its drops.")
    changed, index = imgui.combo("##resolution", view.shrink - 1, ["100 %", "50 %", "33 %"])
    if changed:
        view.shrink = index + 1
    plain_label("Colours on the GPU", "Fewer bits take less memory and, of large scenes, less time a frame.")
    imgui.begin_disabled(session.backend != "opengl")
    storages = list(_STORAGES)
    changed, index = imgui.combo("##harmonics", storages.index(view.harmonics), list(_STORAGES.values()))
    if changed:
        view.harmonics = storages[index]
    imgui.end_disabled()
    plain_label("While moving", "Hold this frame time while the camera moves by drawing less; exact once it rests.")
    _, session.budget.enabled = imgui.checkbox("##budget", session.budget.enabled)
    imgui.same_line()
    imgui.set_next_item_width(-1)
    imgui.begin_disabled(not session.budget.enabled)
    budget = session.budget
    _, budget.target_ms = imgui.slider_float("##target_ms", budget.target_ms, 10, 200, "%.0f ms a frame")
    imgui.end_disabled()
    plain_label("Field of view", "Vertical, in degrees.")
    _, session.navigation.vertical_fov_deg = imgui.slider_float(
        "##fov", session.navigation.vertical_fov_deg, 15, 110, "%.0f\u00b0"
    )
    imgui.separator_text("Window")
    preferences = session.preferences
    plain_label("Theme", "Colours of panels and menus.")
    themes = ["dark", "light"]
    changed, index = imgui.combo("##theme", themes.index(preferences.theme), themes)
    if changed:
        session.prefer(theme=themes[index])
    _preference(session, "font_scale", "Text size", "Times the usual size.", 0.5, 3.0, "%.2f")
    _preference(session, "ui_scale", "Spacing", "Size of buttons and gaps, times the usual.", 0.5, 3.0, "%.2f")
    _preference(
        session, "autosave_s", "Autosave (s)", "A change is kept beside the scene after so long.", 5.0, 600.0, "%.0f"
    )


def _preference(session: Session, name: str, title: str, help_text: str, low: float, high: float, text: str) -> None:
    """Edit a preference; it is taken when the slider is let go, so that nothing jumps under the hand."""
    plain_label(title, help_text)
    held = _held.get(name, getattr(session.preferences, name))
    changed, value = imgui.slider_float(f"##{name}", held, low, high, text, imgui.SliderFlags_.always_clamp)
    if changed:
        _held[name] = value
    if imgui.is_item_deactivated_after_edit() and name in _held:
        session.prefer(**{name: _held.pop(name)})
