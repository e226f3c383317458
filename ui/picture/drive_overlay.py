"""A roll-out over the picture: boxes with names, the plan on the road, the driven way, figures of the moment."""

from imgui_bundle import ImVec2, ImVec4, imgui

from gsrain_engine.drive.metrics.time_to_collision import LONGEST_S
from gsrain_engine.session.drive.rollout_drawing import BoxMark, RolloutDrawing, rollout_drawing
from gsrain_engine.session.drive.seen_boxes import SeenBox, seen_boxes
from gsrain_engine.session.session import Session

from ..widgets.colors import OUTLINE, color
from ..widgets.viewport import Viewport

_PLAN = ImVec4(0.2, 0.95, 0.6, 1.0)
_DRIVEN = ImVec4(0.45, 0.78, 1.0, 0.55)
_USER = ImVec4(1.0, 0.74, 0.3, 0.95)
_EGO = ImVec4(0.45, 0.78, 1.0, 0.95)
_HIT = ImVec4(1.0, 0.3, 0.25, 1.0)
_PAPER = ImVec4(0.06, 0.065, 0.08, 0.8)
_INK = ImVec4(0.94, 0.94, 0.96, 1.0)
_FAINT = ImVec4(0.7, 0.71, 0.75, 1.0)
_SEEN = ImVec4(1.0, 0.5, 0.85, 0.95)
_MARGIN = 10.0
_ENDS = {
    "time": "The time of the scenario is over",
    "completed": "The end of the route",
    "off route": "Too far off the route",
    "agent": "The agent has ended the drive",
    "stopped": "The drive was stopped",
}


def drive_overlay(session: Session, viewport: Viewport) -> bool:
    """Draw the moment of the roll-out that plays; never takes the mouse."""
    drives = session.drives
    shown = drives.shown_in(session)
    if shown is None:
        return False
    inside = drives.chase.mode == "front camera"
    drawing = rollout_drawing(shown, session.clock.time_s, viewport.shot.camera, from_inside=inside)
    if drives.show_plan:
        _plan(viewport, drawing)
    if drives.show_boxes:
        for box in drawing.boxes:
            _box(viewport, box)
    if drives.show_boxes and inside and shown.front_camera is not None:
        step = shown.played.step(shown.own_time_s(session.clock.time_s))
        for seen in seen_boxes(step, shown.front_camera, viewport.shot.camera):
            _seen(viewport, seen)
    _figures(session, viewport)
    return False


def _plan(viewport: Viewport, drawing: RolloutDrawing) -> None:
    draw = imgui.get_window_draw_list()
    for (x0, y0), (x1, y1) in drawing.driven_px.tolist():
        draw.add_line(viewport.on_screen(x0, y0), viewport.on_screen(x1, y1), color(_DRIVEN), 2.0)
    for ink, thick in ((OUTLINE, 4.5), (_PLAN, 2.5)):
        for (x0, y0), (x1, y1) in drawing.plan_px.tolist():
            draw.add_line(viewport.on_screen(x0, y0), viewport.on_screen(x1, y1), color(ink), thick)
    for x, y, radius in drawing.dots:
        draw.add_circle_filled(viewport.on_screen(x, y), radius + 1.5, color(OUTLINE))
        draw.add_circle_filled(viewport.on_screen(x, y), radius, color(_PLAN))


def _box(viewport: Viewport, box: BoxMark) -> None:
    draw, hue = imgui.get_window_draw_list(), _HIT if box.is_hit else (_EGO if box.is_ego else _USER)
    for (x0, y0), (x1, y1) in box.lines_px.tolist():
        draw.add_line(viewport.on_screen(x0, y0), viewport.on_screen(x1, y1), color(hue), 2.0 if box.is_hit else 1.3)
    if box.top_px is None or box.is_ego:
        return
    words = f"{box.name}  {box.speed_m_s:.1f} m/s"
    size = imgui.calc_text_size(words)
    x, y = box.top_px
    low = viewport.on_screen(x - size.x / 2 - 5, y - size.y - 12)
    high = ImVec2(low.x + size.x + 10, low.y + size.y + 4)
    draw.add_rect_filled(low, high, color(_PAPER), 4.0)
    draw.add_text(ImVec2(low.x + 5, low.y + 2), color(hue), words)


def _seen(viewport: Viewport, seen: SeenBox) -> None:
    draw, hue = imgui.get_window_draw_list(), _PLAN if seen.is_lead else _SEEN
    low, high = viewport.on_screen(*seen.low_px), viewport.on_screen(*seen.high_px)
    draw.add_rect(low, high, color(hue), 2.0, thickness=2.0 if seen.is_lead else 1.2)
    size = imgui.calc_text_size(seen.words)
    corner = ImVec2(low.x, high.y + 2)
    draw.add_rect_filled(corner, ImVec2(low.x + size.x + 8, corner.y + size.y), color(_PAPER), 3.0)
    draw.add_text(ImVec2(low.x + 4, corner.y), color(hue), seen.words)


def _figures(session: Session, viewport: Viewport) -> None:
    """Say how the ego vehicle drives now, at the lower edge; above it, what was hit."""
    drives = session.drives
    step, playing, shown = drives.step_now(session), drives.playing, drives.shown_in(session)
    if step is None or playing is None or shown is None:
        return
    time_s = shown.own_time_s(session.clock.time_s)
    state, ttc_s = shown.played.state(time_s), playing.curves.ttc_at(time_s)
    words = [
        f"{time_s:.2f} s",
        f"{state.speed_m_s:.1f} m/s",
        f"{step.ego.acceleration_m_s2:z.1f} m/s\u00b2",
        f"TTC {ttc_s:.1f} s" if ttc_s < LONGEST_S else f"TTC {LONGEST_S:g} s or more",
    ]
    y = viewport.height - _MARGIN
    y = _line(viewport, "    ".join(words), y, _INK)
    if step.collision is not None:
        _line(viewport, f"Hits {step.collision} at {step.ego.speed_m_s:.1f} m/s", y - 4, _HIT)
    elif time_s >= shown.played.end_s:
        _line(viewport, _ENDS.get(playing.rollout.end, playing.rollout.end), y - 4, _FAINT)


def _line(viewport: Viewport, words: str, low: float, ink: ImVec4) -> float:
    """Write a line above a height of the picture; returns the height of its upper edge."""
    size, em = imgui.calc_text_size(words), imgui.get_font_size()
    corner = viewport.on_screen((viewport.width - size.x) / 2 - 0.7 * em, low - size.y - 0.5 * em)
    end = ImVec2(corner.x + size.x + 1.4 * em, corner.y + size.y + 0.5 * em)
    draw = imgui.get_window_draw_list()
    draw.add_rect_filled(corner, end, color(_PAPER), 5.0)
    draw.add_text(ImVec2(corner.x + 0.7 * em, corner.y + 0.25 * em), color(ink), words)
    return low - size.y - 0.5 * em
