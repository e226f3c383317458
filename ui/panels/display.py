"""Display panel and Timeline panel."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.editor import camera_path
from gsrain_engine.editor.editor import Editor
from gsrain_engine.render.opengl.buffers import Harmonics

from ..widgets.fields import plain_label
from .timeline import HEIGHT_EM, keyframe_menu, keyframe_number_fields, playhead, rows, time_ruler, transport

_STORAGES: dict[Harmonics, str] = {"single": "32 bits", "half": "16 bits", "byte": "8 bits"}
_held: dict[str, float] = {}  # values of sliders that are being dragged, by preference


def display_panel(session: Editor) -> None:
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
        session.set_preference(theme=themes[index])
    _preference(session, "font_scale", "Text size", "Times the usual size.", 0.5, 3.0, "%.2f")
    _preference(session, "ui_scale", "Spacing", "Size of buttons and gaps, times the usual.", 0.5, 3.0, "%.2f")
    _preference(
        session, "autosave_s", "Autosave (s)", "A change is kept beside the scene after so long.", 5.0, 600.0, "%.0f"
    )


def _preference(session: Editor, name: str, title: str, help_text: str, low: float, high: float, text: str) -> None:
    """Edit a preference; it applies when the slider is released, so that the layout doesn't change during the drag."""
    plain_label(title, help_text)
    held = _held.get(name, getattr(session.preferences, name))
    changed, value = imgui.slider_float(f"##{name}", held, low, high, text, imgui.SliderFlags_.always_clamp)
    if changed:
        _held[name] = value
    if imgui.is_item_deactivated_after_edit() and name in _held:
        session.set_preference(**{name: _held.pop(name)})


# Timeline panel

_TITLES_EM, _NUMBERS_EM = 6.5, 21.0
_NARROW_EM = 50.0  # width below which the numbers are hidden in favor of the rows


def timeline_panel(session: Editor) -> None:
    em, timeline = imgui.get_font_size(), session.timeline
    transport(session)
    avail = imgui.get_content_region_avail()
    beside = _NUMBERS_EM * em if avail.x > _NARROW_EM * em else 0.0
    titles = _TITLES_EM * em
    # Reserve the width of the scroll bar, so that ruler and rows are equally wide.
    width = max(avail.x - beside - titles - imgui.get_style().scrollbar_size - 8, 60.0)
    timeline.ruler.width_px = width
    if not timeline.is_fitted:
        timeline.ruler.fit(*session.span_s)
        timeline.is_fitted = True
    if session.clock.playing and not imgui.is_mouse_down(imgui.MouseButton_.left):
        timeline.ruler.show(session.clock.time_s)
    start = imgui.get_cursor_screen_pos()
    height = HEIGHT_EM * em
    imgui.set_cursor_screen_pos(ImVec2(start.x + titles, start.y))
    imgui.begin_group()
    time_ruler(session, width)
    playhead(session, ImVec2(start.x + titles, start.y), width, height, with_head=True)
    imgui.end_group()
    imgui.set_cursor_screen_pos(ImVec2(start.x, start.y + height))
    _rows(session, titles, width)
    if beside:
        imgui.set_cursor_screen_pos(ImVec2(start.x + avail.x - beside + 8, start.y))
        if imgui.begin_child("numbers", ImVec2(beside - 8, 0)):
            keyframe_number_fields(session)
        imgui.end_child()
    _keyboard(session)


def _rows(session: Editor, titles: float, width: float) -> None:
    size = ImVec2(titles + width + imgui.get_style().scrollbar_size, 0)
    flags = imgui.WindowFlags_.no_scroll_with_mouse
    shown = imgui.begin_child("rows", size, window_flags=flags)
    corner, height = imgui.get_window_pos(), imgui.get_window_height()
    if shown:
        imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(0, 0))
        rows(session, titles, width)
        imgui.pop_style_var()
        io = imgui.get_io()
        if io.key_shift and io.mouse_wheel and imgui.is_window_hovered():
            imgui.set_scroll_y(imgui.get_scroll_y() - io.mouse_wheel * imgui.get_text_line_height())
        keyframe_menu(session)
        playhead(session, ImVec2(corner.x + titles, corner.y), width, height, with_head=False)
    imgui.end_child()
    _wheel(session, corner.x + titles)


def _wheel(session: Editor, left: float) -> None:
    """Zoom with the wheel and pan with the middle button, over ruler and rows; Shift+wheel scrolls the rows."""
    io, ruler = imgui.get_io(), session.timeline.ruler
    x = imgui.get_mouse_pos().x - left
    if not imgui.is_window_hovered(imgui.HoveredFlags_.child_windows) or not 0 <= x <= ruler.width_px:
        return
    if io.mouse_wheel and not io.key_shift:
        ruler.zoom(io.mouse_wheel, x)
    if imgui.is_mouse_dragging(imgui.MouseButton_.middle, 0):
        ruler.pan(io.mouse_delta.x)


def _keyboard(session: Editor) -> None:
    key = camera_path.active_keyframe(session)
    session.timeline.takes_keys = imgui.is_window_focused(imgui.FocusedFlags_.child_windows)
    if imgui.get_io().want_text_input or key is None:
        return
    if session.timeline.takes_keys and imgui.is_key_pressed(imgui.Key.delete):
        camera_path.delete_keyframe(session, key)
