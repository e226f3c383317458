"""Plot of the Shower panel: draggable keyframes of intensity over time, with those of wind and exposure below."""

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui, implot
from jaxtyping import Float64

from gsrain_engine.editor.editor import Editor
from gsrain_engine.rain.keyframes import HEAVIEST_MM_H, Keyed
from gsrain_engine.rain.settings import CALIBRATED_UP_TO_MM_H

_CURVE = ImVec4(0.42, 0.74, 1.0, 1.0)
_FILL = ImVec4(0.42, 0.74, 1.0, 0.16)
_KEY = ImVec4(1.0, 0.93, 0.45, 1.0)
_NOW = ImVec4(1.0, 0.45, 0.35, 1.0)
_LIMIT = ImVec4(1.0, 0.72, 0.3, 0.55)
_HEIGHT_EM, _MIN_EM, _ROW_EM = 12.0, 7.0, 1.5
_GRIP_PX = 8.0
_MAX_KEYS, _MAX_POINTS = 150, 20_000
_CLOSEST_S = 0.01
_ROWS: tuple[tuple[Keyed, str], ...] = (("wind_m_s", "wind"), ("exposure_s", "exposure"))


def rain_keyframe_plot(session: Editor, width: float) -> None:
    """Draw the plot in the given width in pixels, and handle the mouse."""
    shower, weather = session.shower, session.weather
    shower.follow(weather.heaviest_mm_h(session.rain))
    fit, menu = implot.get_input_map().fit, implot.get_input_map().menu
    implot.get_input_map().fit = implot.get_input_map().menu = imgui.MouseButton_.middle  # both buttons edit keyframes
    flags = implot.Flags_.no_menus | implot.Flags_.no_box_select | implot.Flags_.no_mouse_text
    flags |= implot.Flags_.no_legend | implot.Flags_.no_title
    em = imgui.get_font_size()
    below = em * _ROW_EM * sum(weather.is_keyed(name) for name, _ in _ROWS)
    height = min(max(imgui.get_content_region_avail().y - below, _MIN_EM * em), _HEIGHT_EM * em)
    if implot.begin_plot("##shower", ImVec2(width, height), flags):
        _axes(session)
        _curve(session)
        is_over_key = _keys(session)  # before the clock: where they overlap, the drag moves the keyframe
        _clock(session)
        if implot.is_plot_hovered() and not is_over_key and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            at = implot.get_plot_mouse_pos()
            rate = float(np.clip(round(at.y, 1), 0, HEAVIEST_MM_H))
            session.set_weather("Add a key", weather.with_key(round(at.x, 2), intensity_mm_h=rate))
        position, size, limits = implot.get_plot_pos(), implot.get_plot_size(), implot.get_plot_limits()
        implot.end_plot()
        for name, title in _ROWS:
            if weather.is_keyed(name):
                _row(session, name, title, position, size, (limits.x.min, limits.x.max))
    implot.get_input_map().fit, implot.get_input_map().menu = fit, menu


def _axes(session: Editor) -> None:
    shower, always = session.shower, imgui.Cond_.always
    implot.setup_axes("", "mm/h", implot.AxisFlags_.no_highlight, implot.AxisFlags_.no_highlight)
    first, last = shower.span_s(session.weather, session.clock.time_s)
    implot.setup_axis_limits(implot.ImAxis_.x1, first, last, always if shower.refit else imgui.Cond_.once)
    implot.setup_axis_format(implot.ImAxis_.x1, "%g s")
    shower.refit = False
    implot.setup_axis_limits(implot.ImAxis_.y1, 0.0, shower.top_mm_h, always)


def _curve(session: Editor) -> None:
    limits = implot.get_plot_limits()
    times, rates = _points(session, limits.x.min, limits.x.max)
    implot.plot_shaded("fill", times, rates, spec=implot.Spec(fill_color=_FILL))
    implot.plot_line("rate", times, rates, spec=implot.Spec(line_color=_CURVE, line_weight=2.0))
    if session.shower.top_mm_h > CALIBRATED_UP_TO_MM_H:
        height = np.array([CALIBRATED_UP_TO_MM_H])
        spec = implot.Spec(line_color=_LIMIT, flags=implot.InfLinesFlags_.horizontal)
        implot.plot_inf_lines("calibrated up to", height, spec=spec)
        at = implot.plot_to_pixels(limits.x.max, CALIBRATED_UP_TO_MM_H)
        words = "beyond calibration"
        above = at.y - imgui.get_font_size() - 2
        y = above if above >= implot.get_plot_pos().y else at.y + 1  # no room above the line in a low plot
        place = ImVec2(at.x - imgui.calc_text_size(words).x - 5, y)
        implot.push_plot_clip_rect()
        implot.get_plot_draw_list().add_text(place, imgui.get_color_u32(_LIMIT), words)
        implot.pop_plot_clip_rect()


def _points(session: Editor, first: float, last: float) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Return the visible curve: its corners, or evenly spaced points if there are too many."""
    curve = session.weather.curves.get("intensity_mm_h")
    if curve is None:
        return np.array([first, last]), np.full(2, session.rain.intensity_mm_h)
    inside = curve.times_s[(curve.times_s > first) & (curve.times_s < last)]
    if len(inside) > _MAX_POINTS:
        inside = np.linspace(first, last, _MAX_POINTS)[1:-1]
    times = np.concatenate([[first], inside, [last]])
    return times, np.interp(times, curve.times_s, curve.values[:, 0])


def _clock(session: Editor) -> None:
    now_s, clock = session.clock.time_s, session.clock
    changed, moved, *_ = implot.drag_line_x(1, now_s, _NOW, 1.5, implot.DragToolFlags_.no_fit, False, False, False)
    if changed:
        clock.time_s = moved
    implot.tag_x(now_s, _NOW, f"{now_s:.2f}")


def _keys(session: Editor) -> bool:
    """Draw the intensity keyframes and drag them; returns True if the mouse is over one."""
    shower, weather, limits = session.shower, session.weather, implot.get_plot_limits()
    times = weather.key_times["intensity_mm_h"]
    seen = range(*np.searchsorted(times, (limits.x.min, limits.x.max)).tolist())
    if len(seen) > _MAX_KEYS:
        implot.push_plot_clip_rect()
        corner = implot.get_plot_pos()
        words = f"{len(seen):,} keys: zoom in to drag"
        color = imgui.get_color_u32(imgui.Col_.text_disabled)
        implot.get_plot_draw_list().add_text(ImVec2(corner.x + 8, corner.y + 5), color, words)
        implot.pop_plot_clip_rect()
        return False
    is_over, was_held = False, shower.is_held
    shower.is_held = False
    for number in seen:
        key = weather.key_at(times[number])
        assert key is not None, "a key stands at each of its times"
        rate = key.intensity_mm_h or 0.0
        moved, at, height, _, hovered, held = implot.drag_point(
            100 + number, key.time_s, rate, _KEY, 5.0, implot.DragToolFlags_.no_fit, False, False, False
        )
        is_over, shower.is_held = is_over or bool(hovered) or bool(held), shower.is_held or bool(held)
        if hovered and not held:
            imgui.set_tooltip(f"{key.time_s:.2f} s, {rate:.2f} mm/h. Drag it; right click or Delete removes it.")
        if hovered and (imgui.is_mouse_clicked(imgui.MouseButton_.right) or _deletes(session)):
            session.set_weather("Remove a key", weather.without_key(key.time_s, "intensity_mm_h"))
            return True
        if moved:
            to_s = _between(times, number, at)
            height = float(np.clip(height, 0.0, HEAVIEST_MM_H))
            changed = weather.moved_key(key.time_s, to_s, "intensity_mm_h", intensity_mm_h=height)
            session.set_weather("Move a key", changed, "shower key")
    if was_held and not shower.is_held:
        session.end_gesture()
    return is_over


def _deletes(session: Editor) -> bool:
    """Return True if Delete was pressed and applies here: selected Gaussians take precedence."""
    selected = any(each.marks.selected is not None for each in session.scene.members)
    return imgui.is_key_pressed(imgui.Key.delete) and not selected


def _between(times: Float64[np.ndarray, " n"], number: int, wanted: float) -> float:
    low = times[number - 1] + _CLOSEST_S if number > 0 else -np.inf
    high = times[number + 1] - _CLOSEST_S if number + 1 < len(times) else np.inf
    return float(times[number]) if low > high else float(np.clip(wanted, low, high))


def _row(
    session: Editor, name: Keyed, title: str, position: ImVec2, size: ImVec2, shown_s: tuple[float, float]
) -> None:
    """Draw the keyframes of another field as diamonds below the plot; they are dragged in time."""
    height, draw = _ROW_EM * imgui.get_font_size(), imgui.get_window_draw_list()
    top = imgui.get_cursor_screen_pos()
    imgui.dummy(ImVec2(1, height))
    after = imgui.get_cursor_screen_pos()
    middle = top.y + height / 2
    draw.add_rect_filled(
        ImVec2(position.x, top.y), ImVec2(position.x + size.x, top.y + height), imgui.get_color_u32(imgui.Col_.frame_bg)
    )
    draw.add_text(ImVec2(position.x + 4, top.y + 1), imgui.get_color_u32(imgui.Col_.text_disabled), title)
    scale = size.x / (shown_s[1] - shown_s[0])
    times = session.weather.key_times[name]
    first, end = np.searchsorted(times, shown_s).tolist()
    for number in range(first, min(end, first + _MAX_KEYS)):
        key = session.weather.key_at(times[number])
        assert key is not None, "a key stands at each of its times"
        x = position.x + (key.time_s - shown_s[0]) * scale
        imgui.set_cursor_screen_pos(ImVec2(x - _GRIP_PX, middle - _GRIP_PX))
        imgui.invisible_button(f"{name} {number}", ImVec2(2 * _GRIP_PX, 2 * _GRIP_PX))
        _diamond(draw, x, middle, bright=imgui.is_item_hovered() or imgui.is_item_active())
        imgui.set_item_tooltip(
            f"{_value_text(name, getattr(key, name))} at {key.time_s:.2f} s. Drag it; right click or Delete removes it."
        )
        if imgui.is_item_clicked(imgui.MouseButton_.right) or (imgui.is_item_hovered() and _deletes(session)):
            session.set_weather("Remove a key", session.weather.without_key(key.time_s, name))
            break
        if imgui.is_item_active() and imgui.get_io().mouse_delta.x:
            wanted = shown_s[0] + (imgui.get_mouse_pos().x - position.x) / scale
            changed = session.weather.moved_key(key.time_s, _between(times, number, wanted), name)
            session.set_weather("Move a key", changed, f"shower {name}")
        if imgui.is_item_deactivated():
            session.end_gesture()
    imgui.set_cursor_screen_pos(after)
    imgui.dummy(ImVec2(0, 0))


def _diamond(draw: imgui.ImDrawList, x: float, y: float, *, bright: bool) -> None:
    radius = 6.5 if bright else 5.0
    corners = ImVec2(x, y - radius), ImVec2(x + radius, y), ImVec2(x, y + radius), ImVec2(x - radius, y)
    draw.add_quad_filled(*corners, imgui.get_color_u32(_KEY))


def _value_text(name: Keyed, value: float | tuple[float, float]) -> str:
    if isinstance(value, tuple):
        return f"wind {value[0]:.1f}, {value[1]:.1f} m/s"
    return f"{name.removesuffix('_s')} {1000 * value:.2f} ms"
