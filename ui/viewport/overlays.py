"""Overlays on the viewport: camera path, capture, matching, roll-out, divider and preview."""

from collections.abc import Callable

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui
from jaxtyping import Float64

from gsrain_engine.appearance.correspondence import COLORS, MatchOutcome
from gsrain_engine.editor import camera_path
from gsrain_engine.editor.capture_view import LARGE_PX, THUMBNAIL_PX, ImageRequest
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.matching import MatchResult
from gsrain_engine.editor.overlays import Frustum, KeyHandle, drag_in_view, frustums, image_grid, path_overlay_of
from gsrain_engine.editor.overlays_drive import BoxMark, DetectionBox, RolloutOverlay, detection_boxes, rollout_overlay
from gsrain_engine.scene.camera import Camera
from gsrain_engine.simulation.metrics.collisions import LONGEST_S

from ..widgets.draw import CHOSEN, KEY, OUTLINE, PLAYHEAD, Viewport, color

Overlay = Callable[[Editor, Viewport], bool]
"""Draws into the window's draw list; returns True if it uses the left mouse button now (a handle is dragged)."""

# Camera path


def path_overlay(session: Editor, viewport: Viewport) -> bool:
    """Draw the path, unless the camera rides along it; returns True if a keyframe is dragged or under the mouse."""
    timeline = session.timeline
    drag = timeline.drag if timeline.drag is not None and timeline.drag.in_view else None
    if not timeline.show_path or session.view.follow_path:
        return False
    drawing = path_overlay_of(session, viewport.shot.camera)
    if drawing is None:
        return False
    _lines(viewport, drawing.path_px, _PATH_COLOR, 2.0)
    for x, y in drawing.ticks_px.tolist():
        imgui.get_window_draw_list().add_circle_filled(viewport.on_screen(x, y), 2.5, color(_PATH_COLOR))
    _lines(viewport, drawing.now_px, PLAYHEAD, 1.5)
    under = _under_the_mouse(viewport, drawing.keys) if session.view.tool == "" or drag is not None else None
    for mark in drawing.keys:
        _key(session, viewport, mark, is_near=mark.key == under)
    if drag is not None:
        _drag(session, viewport)
        return True
    if under is None or not viewport.hovered:
        return False
    imgui.set_tooltip(
        f"Keyframe {under + 1}. Drag: move it in the plane that faces you. Shift+drag: up and down. Click: choose it."
    )
    if imgui.is_mouse_clicked(_LEFT):
        camera_path.begin_drag(session, under, in_view=True)
    return True


# Capture


def capture_overlay(session: Editor, viewport: Viewport) -> bool:
    """Draw the visible parts of the capture; returns True if the mouse is over one of its cameras."""
    captures = session.captures
    captures.viewport_px = viewport.width, viewport.height
    if captures.capture is None:
        return False
    here = captures.stands_at(session)
    if here is not None:
        _recorded_image(session, viewport, here)
    if captures.points_texture is not None:
        low, high = viewport.corner, viewport.on_screen(viewport.width, viewport.height)
        imgui.get_window_draw_list().add_image(imgui.ImTextureRef(captures.points_texture.name), low, high)
    if here is not None:
        return False  # from inside, frustums would hide the compared images
    if not captures.show_frustums:
        return False
    length = captures.length_m(session.scene)
    cameras = captures.cameras(session.scene)
    found = frustums(cameras, captures.listed, length, viewport.shot.camera)
    under = _capture_under_the_mouse(viewport, found) if viewport.hovered and session.view.tool == "" else None
    for number, each in enumerate(found):
        if number >= len(found) - _IMAGES:
            _image(session, viewport, cameras[each.view], each.view, THUMBNAIL_PX, 1.0)
        _frustum(session, viewport, each, is_near=under is each)
    return under is not None and _act(session, under)


# Matching


def matching_overlay(session: Editor, viewport: Viewport) -> bool:
    """Draw the match with another view, if enabled; never uses the mouse."""
    matching = session.matching
    if not matching.is_on:
        return False
    shown = matching.shown
    if shown is None:
        _card(viewport, matching.problem or "Matching...", [])
        return False
    texture = session.matching.texture
    grid = image_grid(shown.camera, 1.0, viewport.shot.camera, _CELLS)
    if texture is None or grid is None:
        return False
    draw_placed_image(viewport, texture.name, grid, 1.0)
    if matching.lines:
        _matching_lines(viewport, shown, grid)
    under = _match_under_the_mouse(viewport, shown, grid)
    _inset(session, viewport, shown, under)
    named = [each for each in shown.shares.items() if each[1] >= _MIN_SHARE]
    if matching.mode != "pixels":  # matches have their own colors, and the title has their share
        named = [each for each in named if each[0] != MatchOutcome.MATCHED]
    _card(viewport, _title(shown), named)
    return False


# Roll-out


def drive_overlay(session: Editor, viewport: Viewport) -> bool:
    """Draw the roll-out at the current time; never uses the mouse."""
    drives = session.drives
    shown = drives.placed_in(session)
    if shown is None:
        return False
    inside = drives.chase.mode == "front camera"
    drawing = rollout_overlay(shown, session.clock.time_s, viewport.shot.camera, from_inside=inside)
    if drives.show_plan:
        _plan(viewport, drawing)
    if drives.show_boxes:
        for box in drawing.boxes:
            _box(viewport, box)
    if drives.show_boxes and inside and shown.front_camera is not None:
        step = shown.played.step(shown.own_time_s(session.clock.time_s))
        for seen in detection_boxes(step, shown.front_camera, viewport.shot.camera):
            _draw_detection(viewport, seen)
    _figures(session, viewport)
    return False


OVERLAYS: tuple[Overlay, ...] = (capture_overlay, matching_overlay, path_overlay, drive_overlay)
_PATH_COLOR = ImVec4(0.55, 0.78, 1.0, 0.9)
_HANDLE, _REACH = 5.5, 10.0
_LEFT = imgui.MouseButton_.left
_DRAG_PX = 2.0


def _drag(session: Editor, viewport: Viewport) -> None:
    drag, moved = session.timeline.drag, imgui.get_mouse_drag_delta(_LEFT, _DRAG_PX)
    if drag is None:
        return
    if moved.x or moved.y:
        session.timeline.drag = drag = drag.begun()
    if drag.has_moved:
        drag_in_view(session, viewport.shot, (moved.x, moved.y), upright=imgui.get_io().key_shift)
    if not imgui.is_mouse_down(_LEFT):
        camera_path.end_drag(session)


def _under_the_mouse(viewport: Viewport, keys: list[KeyHandle]) -> int | None:
    """Return the keyframe whose handle is under the mouse; of several, the one drawn last."""
    x, y = viewport.mouse_px
    for mark in reversed(keys):
        if abs(mark.handle_px[0] - x) <= _REACH and abs(mark.handle_px[1] - y) <= _REACH:
            return mark.key
    return None


def _key(session: Editor, viewport: Viewport, mark: KeyHandle, *, is_near: bool) -> None:
    draw, hue = imgui.get_window_draw_list(), CHOSEN if camera_path.active_keyframe(session) == mark.key else KEY
    _lines(viewport, mark.frustum_px, hue, 1.5)
    at = viewport.on_screen(*mark.handle_px)
    radius = _HANDLE + (2 if is_near else 0)
    draw.add_circle_filled(at, radius + 1.5, color(OUTLINE))
    draw.add_circle_filled(at, radius, color(hue))
    low = at.y + 0.35 * imgui.get_font_size()
    for offset, ink in ((1.0, OUTLINE), (0.0, hue)):
        draw.add_text(ImVec2(at.x + radius + 3 + offset, low + offset), color(ink), str(mark.key + 1))


def _lines(viewport: Viewport, lines_px: Float64[np.ndarray, "m 2 2"], hue: ImVec4, width: float) -> None:
    draw = imgui.get_window_draw_list()
    for (x0, y0), (x1, y1) in lines_px.tolist():
        draw.add_line(viewport.on_screen(x0, y0), viewport.on_screen(x1, y1), color(OUTLINE), width + 1.5)
    for (x0, y0), (x1, y1) in lines_px.tolist():
        draw.add_line(viewport.on_screen(x0, y0), viewport.on_screen(x1, y1), color(hue), width)


_CAMERA = ImVec4(0.5, 0.85, 0.62, 0.9)
_CAPTURE_HANDLE, _CAPTURE_REACH = 4.0, 9.0
_IMAGES = 24  # number of nearest cameras that show their images


def _recorded_image(session: Editor, viewport: Viewport, view: int) -> None:
    captures = session.captures
    camera = captures.cameras(session.scene)[view]
    if captures.show_picture and captures.opacity > 0:
        is_there = ImageRequest(view, LARGE_PX) in captures.textures
        if captures.pictures is not None:
            captures.pictures.want(view, LARGE_PX)
        _image(session, viewport, camera, view, LARGE_PX if is_there else THUMBNAIL_PX, captures.opacity)
    grid = image_grid(camera, captures.length_m(session.scene), viewport.shot.camera, (1, 1))
    if grid is not None:
        a, b, d, c = (viewport.on_screen(x, y) for x, y in grid.reshape(4, 2).tolist())
        imgui.get_window_draw_list().add_quad(a, b, c, d, color(CHOSEN), 1.5)


def _image(session: Editor, viewport: Viewport, camera: Camera, view: int, width: int, opacity: float) -> None:
    """Draw a recorded image in its camera's frustum; in cells, since draw lists have no perspective."""
    captures = session.captures
    if captures.pictures is None:
        return
    captures.pictures.want(view, width)
    texture = captures.textures.get(ImageRequest(view, width))
    cells = (4, 3) if width == THUMBNAIL_PX else (8, 6)
    grid = image_grid(camera, captures.length_m(session.scene), viewport.shot.camera, cells)
    if texture is not None and grid is not None:
        draw_placed_image(viewport, texture.name, grid, opacity)


def _frustum(session: Editor, viewport: Viewport, frustum: Frustum, *, is_near: bool) -> None:
    draw, is_chosen = imgui.get_window_draw_list(), session.captures.chosen == frustum.view
    hue = CHOSEN if is_chosen or is_near else _CAMERA
    for (x0, y0), (x1, y1) in frustum.lines_px.tolist():
        draw.add_line(viewport.on_screen(x0, y0), viewport.on_screen(x1, y1), color(hue), 2.0 if is_chosen else 1.0)
    if frustum.eye_px is not None:
        at = viewport.on_screen(*frustum.eye_px)
        draw.add_circle_filled(at, _CAPTURE_HANDLE + 1.5 + 2 * is_near, color(OUTLINE))
        draw.add_circle_filled(at, _CAPTURE_HANDLE + 2 * is_near, color(hue))


def _capture_under_the_mouse(viewport: Viewport, found: list[Frustum]) -> Frustum | None:
    x, y = viewport.mouse_px
    near = [
        each
        for each in found
        if (at := each.eye_px) and abs(at[0] - x) <= _CAPTURE_REACH and abs(at[1] - y) <= _CAPTURE_REACH
    ]
    return near[-1] if near else None


def _act(session: Editor, frustum: Frustum) -> bool:
    captures = session.captures
    assert captures.capture is not None, "only a capture has cameras"
    view = captures.capture[frustum.view]
    moment = f", {view.time_s:.2f} s" if captures.has_times else ""
    imgui.set_tooltip(f"{view.name}{moment}. Click: choose it. Double click: look from there.")
    if imgui.is_mouse_double_clicked(_LEFT):
        captures.look_from(session, frustum.view)
    elif imgui.is_mouse_clicked(_LEFT):
        captures.chosen = frustum.view
    return True


# Image in perspective, drawn in cells since draw lists have no perspective


def draw_placed_image(
    viewport: Viewport, texture: int, grid: Float64[np.ndarray, "rows columns 2"], opacity: float
) -> None:
    """Draw a texture (its OpenGL name), first row on top, onto a grid of viewport pixels."""
    low, high = grid.min(axis=(0, 1)), grid.max(axis=(0, 1))
    if not (high[0] > 0 and high[1] > 0 and low[0] < viewport.width and low[1] < viewport.height):
        return
    draw, tint = imgui.get_window_draw_list(), imgui.get_color_u32(ImVec4(1.0, 1.0, 1.0, opacity))
    on_screen = [[viewport.on_screen(x, y) for x, y in row] for row in grid.tolist()]
    rows, columns = len(on_screen) - 1, len(on_screen[0]) - 1
    for row in range(rows):
        top, bottom = row / rows, (row + 1) / rows
        for column in range(columns):
            left, right = column / columns, (column + 1) / columns
            draw.add_image_quad(
                imgui.ImTextureRef(texture),
                on_screen[row][column],
                on_screen[row][column + 1],
                on_screen[row + 1][column + 1],
                on_screen[row + 1][column],
                ImVec2(left, top),
                ImVec2(right, top),
                ImVec2(right, bottom),
                ImVec2(left, bottom),
                tint,
            )


WORDS: dict[MatchOutcome, str] = {
    MatchOutcome.MATCHED: "matched",
    MatchOutcome.HIDDEN: "hidden there",
    MatchOutcome.EDGE: "edge of something",
    MatchOutcome.MOVING: "may have moved",
    MatchOutcome.UNKNOWN: "depth unknown",
    MatchOutcome.OUTSIDE: "outside that view",
}

_CELLS = (8, 6)
_MIN_SHARE = 0.005  # minimum share of the image for an entry in the legend
_LINE = ImVec4(0.35, 0.95, 0.6, 0.85)
_INSET_SHARE, _MAX_INSET_EM, _MARGIN = 0.3, 16.0, 10.0
_PAPER = ImVec4(0.06, 0.065, 0.08, 0.82)
_INK = ImVec4(0.94, 0.94, 0.96, 1.0)
_FAINT = ImVec4(0.7, 0.71, 0.75, 1.0)


def _title(shown: MatchResult) -> str:
    return f"{shown.matched.found.valid.mean():.0%} matched with {shown.matched.to.name}"


def _matching_lines(viewport: Viewport, shown: MatchResult, grid: Float64[np.ndarray, "rows columns 2"]) -> None:
    draw = imgui.get_window_draw_list()
    starts, ends = (_on_grid(shown.lines[:, k], grid) for k in (0, 1))
    for (x0, y0), (x1, y1) in zip(starts.tolist(), ends.tolist(), strict=True):
        start, end = viewport.on_screen(x0, y0), viewport.on_screen(x1, y1)
        draw.add_line(start, end, color(OUTLINE), 3.0)
        draw.add_line(start, end, color(_LINE), 1.3)
        draw.add_circle_filled(start, 2.4, color(OUTLINE))
        draw.add_circle_filled(start, 1.6, color(_LINE))


def _on_grid(shares: np.ndarray, grid: Float64[np.ndarray, "rows columns 2"]) -> Float64[np.ndarray, "n 2"]:
    """Return viewport pixels at relative positions of the image; the image's corners are those of the grid."""
    x, y = shares[:, :1].astype(np.float64), shares[:, 1:].astype(np.float64)
    top = (1 - x) * grid[0, 0] + x * grid[0, -1]
    bottom = (1 - x) * grid[-1, 0] + x * grid[-1, -1]
    return (1 - y) * top + y * bottom


def _match_under_the_mouse(
    viewport: Viewport, shown: MatchResult, grid: Float64[np.ndarray, "rows columns 2"]
) -> tuple[int, int] | None:
    """Return row and column of the matched image under the mouse; None outside it."""
    if not viewport.hovered:
        return None
    height, width = shown.matched.found.outcome.shape
    right, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    away = np.array(viewport.mouse_px) - grid[0, 0]
    share = np.linalg.solve(np.stack([right, down], axis=1), away)
    column, row = int(np.floor(share[0] * width)), int(np.floor(share[1] * height))
    return (row, column) if 0 <= row < height and 0 <= column < width else None


def _inset(session: Editor, viewport: Viewport, shown: MatchResult, under: tuple[int, int] | None) -> None:
    """Draw the other view in the corner, with a cross at the pixel that matches the mouse position."""
    captures, other = session.captures, shown.matched.to
    if captures.pictures is None:
        return
    captures.pictures.want(shown.request.to, THUMBNAIL_PX)
    texture = captures.textures.get(ImageRequest(shown.request.to, THUMBNAIL_PX))
    if texture is None:
        return
    width = min(_INSET_SHARE * viewport.width, _MAX_INSET_EM * imgui.get_font_size())
    height = width * other.camera.height / other.camera.width
    low = viewport.on_screen(viewport.width - width - _MARGIN, _MARGIN)
    high = ImVec2(low.x + width, low.y + height)
    draw = imgui.get_window_draw_list()
    draw.add_image(imgui.ImTextureRef(texture.name), low, high)
    draw.add_rect(low, high, color(CHOSEN), thickness=1.5)
    if under is None:
        return
    outcome = MatchOutcome(int(shown.matched.found.outcome[under]))
    if outcome == MatchOutcome.MATCHED:
        x, y = shown.matched.found.places[under].tolist()
        at = ImVec2(low.x + x / other.camera.width * width, low.y + y / other.camera.height * height)
        for line, thick in ((OUTLINE, 3.5), (CHOSEN, 1.5)):
            draw.add_line(ImVec2(at.x - 7, at.y), ImVec2(at.x + 7, at.y), color(line), thick)
            draw.add_line(ImVec2(at.x, at.y - 7), ImVec2(at.x, at.y + 7), color(line), thick)
        imgui.set_tooltip(f"There at column {x:.1f}, row {y:.1f} of {other.camera.width} x {other.camera.height} px.")
    else:
        imgui.set_tooltip(f"No match in {other.name}: {WORDS[outcome]}.")


def _card(viewport: Viewport, title: str, shares: list[tuple[MatchOutcome, float]]) -> None:
    """Draw the legend in the lower right corner; tools are on the left."""
    draw, em = imgui.get_window_draw_list(), imgui.get_font_size()
    line = imgui.get_text_line_height() * 1.2
    rows = [f"{WORDS[each]}  {share:.0%}" for each, share in shares]
    width = max([imgui.calc_text_size(title).x, *(imgui.calc_text_size(row).x + 1.4 * em for row in rows)]) + 1.2 * em
    height = (1 + len(rows)) * line + 0.8 * em
    low = viewport.on_screen(viewport.width - width - _MARGIN, viewport.height - height - _MARGIN)
    draw.add_rect_filled(low, ImVec2(low.x + width, low.y + height), color(_PAPER), 5.0)
    x, y = low.x + 0.6 * em, low.y + 0.4 * em
    draw.add_text(ImVec2(x, y), color(_INK), title)
    for (outcome, _), row in zip(shares, rows, strict=True):
        y += line
        red, green, blue = COLORS[outcome]
        box = ImVec2(x, y + 0.2 * em), ImVec2(x + 0.8 * em, y + em)
        draw.add_rect_filled(*box, color(ImVec4(red, green, blue, 1.0)), 2.0)
        draw.add_rect(*box, color(_FAINT), 2.0)
        draw.add_text(ImVec2(x + 1.4 * em, y), color(_FAINT), row)


_PLAN = ImVec4(0.2, 0.95, 0.6, 1.0)
_DRIVEN = ImVec4(0.45, 0.78, 1.0, 0.55)
_USER = ImVec4(1.0, 0.74, 0.3, 0.95)
_EGO = ImVec4(0.45, 0.78, 1.0, 0.95)
_HIT = ImVec4(1.0, 0.3, 0.25, 1.0)
_ROLLOUT_PAPER = ImVec4(0.06, 0.065, 0.08, 0.8)
_DETECTION_COLOR = ImVec4(1.0, 0.5, 0.85, 0.95)
_ROLLOUT_MARGIN = 10.0

_ENDS = {
    "time": "The time of the scenario is over",
    "completed": "The end of the route",
    "off route": "Too far off the route",
    "agent": "The agent has ended the drive",
    "stopped": "The drive was stopped",
}


def _plan(viewport: Viewport, drawing: RolloutOverlay) -> None:
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
    draw.add_rect_filled(low, high, color(_ROLLOUT_PAPER), 4.0)
    draw.add_text(ImVec2(low.x + 5, low.y + 2), color(hue), words)


def _draw_detection(viewport: Viewport, seen: DetectionBox) -> None:
    draw, hue = imgui.get_window_draw_list(), _PLAN if seen.is_lead else _DETECTION_COLOR
    low, high = viewport.on_screen(*seen.low_px), viewport.on_screen(*seen.high_px)
    draw.add_rect(low, high, color(hue), 2.0, thickness=2.0 if seen.is_lead else 1.2)
    size = imgui.calc_text_size(seen.words)
    corner = ImVec2(low.x, high.y + 2)
    draw.add_rect_filled(corner, ImVec2(low.x + size.x + 8, corner.y + size.y), color(_ROLLOUT_PAPER), 3.0)
    draw.add_text(ImVec2(low.x + 4, corner.y), color(hue), seen.words)


def _figures(session: Editor, viewport: Viewport) -> None:
    """Draw the ego vehicle's current state at the lower edge; above it, the collision."""
    drives = session.drives
    step, playing, shown = drives.step_now(session), drives.playing, drives.placed_in(session)
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
    y = viewport.height - _ROLLOUT_MARGIN
    y = _line(viewport, "    ".join(words), y, _INK)
    if step.collision is not None:
        _line(viewport, f"Hits {step.collision} at {step.ego.speed_m_s:.1f} m/s", y - 4, _HIT)
    elif time_s >= shown.played.end_s:
        _line(viewport, _ENDS.get(playing.rollout.end, playing.rollout.end), y - 4, _FAINT)


def _line(viewport: Viewport, words: str, low: float, ink: ImVec4) -> float:
    """Draw a line of text above a height of the viewport; returns the height of its upper edge."""
    size, em = imgui.calc_text_size(words), imgui.get_font_size()
    corner = viewport.on_screen((viewport.width - size.x) / 2 - 0.7 * em, low - size.y - 0.5 * em)
    end = ImVec2(corner.x + size.x + 1.4 * em, corner.y + size.y + 0.5 * em)
    draw = imgui.get_window_draw_list()
    draw.add_rect_filled(corner, end, color(_ROLLOUT_PAPER), 5.0)
    draw.add_text(ImVec2(corner.x + 0.7 * em, corner.y + 0.25 * em), color(ink), words)
    return low - size.y - 0.5 * em


# Divider of two images

_HALF_GRIP = 6.0
_DIVIDER_MARGIN = 8.0


def draw_divider(session: Editor, labels: tuple[str, str], corner: ImVec2, width: int, height: int) -> None:
    """Draw the draggable divider with the labels of both sides; a double click centers it."""
    view = session.view
    x = corner.x + view.divider * width
    imgui.set_cursor_screen_pos(ImVec2(x - _HALF_GRIP, corner.y))
    imgui.invisible_button("divider", ImVec2(2 * _HALF_GRIP, height))
    held, hovered = imgui.is_item_active(), imgui.is_item_hovered()
    if held or hovered:
        imgui.set_mouse_cursor(imgui.MouseCursor_.resize_ew)
    if held:
        view.divider = min(max(view.divider + imgui.get_io().mouse_delta.x / width, 0.0), 1.0)
    if hovered and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
        view.divider = 0.5
    _line_and_labels(session, labels, corner, width, height, bright=held or hovered)


def _line_and_labels(
    session: Editor, labels: tuple[str, str], corner: ImVec2, width: int, height: int, *, bright: bool
) -> None:
    left, right = labels
    x = corner.x + session.view.divider * width
    draw = imgui.get_window_draw_list()
    draw.push_clip_rect(corner, ImVec2(corner.x + width, corner.y + height), True)
    color = imgui.get_color_u32((1.0, 1.0, 1.0, 1.0 if bright else 0.75))
    draw.add_line(ImVec2(x, corner.y), ImVec2(x, corner.y + height), color, 2.0)
    draw.add_circle_filled(ImVec2(x, corner.y + height / 2), 7.0, color)
    size = imgui.calc_text_size(left)
    _label(draw, left, ImVec2(x - size.x - 2 * _DIVIDER_MARGIN, corner.y + _DIVIDER_MARGIN))
    _label(draw, right, ImVec2(x + 2 * _DIVIDER_MARGIN, corner.y + _DIVIDER_MARGIN))
    draw.pop_clip_rect()


def _label(draw: imgui.ImDrawList, text: str, at: ImVec2) -> None:
    size = imgui.calc_text_size(text)
    dark = imgui.get_color_u32((0.0, 0.0, 0.0, 0.55))
    draw.add_rect_filled(ImVec2(at.x - 5, at.y - 2), ImVec2(at.x + size.x + 5, at.y + size.y + 2), dark, 3.0)
    draw.add_text(at, imgui.get_color_u32((1.0, 1.0, 1.0, 0.95)), text)


# Preview next to the live view

LABELS = "now", "preview, soaked"


def preview_side(session: Editor, corner: ImVec2, width: int, height: int) -> tuple[str, str] | None:
    """Draw the preview over the right part of the viewport; returns the labels of both sides, or None."""
    rainy = session.rainy
    rainy.viewport_px = width, height
    if session.view.split != "now | preview" or rainy.texture is None or not rainy.fits(session):
        return None
    at = session.view.divider
    low, high = ImVec2(corner.x + at * width, corner.y), ImVec2(corner.x + width, corner.y + height)
    imgui.get_window_draw_list().add_image(imgui.ImTextureRef(rainy.texture.name), low, high, ImVec2(at, 0))
    return LABELS
