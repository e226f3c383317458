"""The rows of the timeline: camera keys that are dragged, keys of the rain, and who is in the scene when."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.session import Session
from gsrain_engine.session.timeline.rows import TimelineRow, track_rows, weather_row
from gsrain_engine.session.timeline.timeline import speed_of

from ...widgets.colors import DIM, FLIGHT, OUTLINE, PRESENT, RAIN, STRIPE, TEXT, TOO_FAST, color
from .keys import camera_keys

ROW_EM = 1.3
_RADIUS = 4.0


def rows(session: Session, titles_px: float, width: float) -> None:
    """Draw all rows from the cursor on, with their titles to the left."""
    _camera(session, titles_px, width)
    ruler, weather = session.timeline.ruler, session.weather
    last_s = ruler.first_s + ruler.shown_s
    if weather.keys:
        _row(session, weather_row(weather, ruler.first_s, last_s, int(width / 6)), titles_px, width, is_rain=True)
    for row in track_rows(session.shown_scene):
        _row(session, row, titles_px, width)


def _camera(session: Session, titles_px: float, width: float) -> None:
    corner, height = _begin("camera", "Keys of the camera path.", titles_px, width)
    draw, ruler, path = imgui.get_window_draw_list(), session.timeline.ruler, session.scene.path
    if path is None:
        hint = "No keys yet: find a view, press K; go on in time, find another, press K again."
        draw.add_text(ImVec2(corner.x + 32, corner.y + 0.12 * height), color(DIM), hint)
    else:
        spans = [(path.start_s, path.end_s, FLIGHT)]
        spans += [(first, last, TOO_FAST) for first, last in speed_of(session.path).implausible_spans]
        for first, last, hue in spans:
            x0, x1 = corner.x + ruler.x(first), corner.x + ruler.x(last)
            draw.add_rect_filled(
                ImVec2(x0, corner.y + 0.4 * height), ImVec2(max(x1, x0 + 2), corner.y + 0.6 * height), color(hue), 2.0
            )
        camera_keys(session, corner, width, height)
    draw.pop_clip_rect()
    imgui.set_cursor_screen_pos(ImVec2(corner.x - titles_px, corner.y))
    imgui.dummy(ImVec2(titles_px + width, height))


def _row(session: Session, row: TimelineRow, titles_px: float, width: float, *, is_rain: bool = False) -> None:
    corner, height = _begin(row.title, row.help, titles_px, width)
    draw, ruler = imgui.get_window_draw_list(), session.timeline.ruler
    inset = 0.4 if is_rain else 0.25
    for first, last in row.spans_s:
        x0, x1 = corner.x + ruler.x(first), corner.x + ruler.x(last)
        top, low = corner.y + inset * height, corner.y + (1 - inset) * height
        draw.add_rect_filled(ImVec2(x0, top), ImVec2(max(x1, x0 + 2), low), color(FLIGHT if is_rain else PRESENT), 2.0)
    for moment in row.keys_s:
        at = ImVec2(corner.x + ruler.x(moment), corner.y + height / 2)
        draw.add_circle_filled(at, _RADIUS + 1, color(OUTLINE))
        draw.add_circle_filled(at, _RADIUS, color(RAIN))
    draw.pop_clip_rect()
    imgui.set_cursor_screen_pos(ImVec2(corner.x - titles_px, corner.y))
    imgui.dummy(ImVec2(titles_px + width, height))


def _begin(title: str, help_text: str, titles_px: float, width: float) -> tuple[ImVec2, float]:
    """Draw title and background of a row; what follows is clipped to its part right of the titles."""
    start, height = imgui.get_cursor_screen_pos(), ROW_EM * imgui.get_font_size()
    draw, corner = imgui.get_window_draw_list(), ImVec2(start.x + titles_px, start.y)
    imgui.invisible_button(f"row {title}", ImVec2(titles_px - 4, height))
    imgui.set_item_tooltip(f"{title}: {help_text}")
    draw.push_clip_rect(start, ImVec2(corner.x - 4, start.y + height), True)
    draw.add_text(ImVec2(start.x + 4, start.y + 0.15 * height), color(TEXT), title)
    draw.pop_clip_rect()
    draw.push_clip_rect(corner, ImVec2(corner.x + width, corner.y + height), True)
    draw.add_rect_filled(corner, ImVec2(corner.x + width, corner.y + height - 1), color(STRIPE))
    return corner, height
