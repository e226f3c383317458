"""Overlays on the viewport: selection, camera path, capture, matching, roll-out, divider and preview."""

from collections.abc import Callable
from itertools import groupby, pairwise

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui
from jaxtyping import Float64

from gsrain_engine.appearance.correspondence import COLORS, MatchOutcome
from gsrain_engine.editor.camera_path import CameraPathEditor
from gsrain_engine.editor.capture_view import LARGE_PX, THUMBNAIL_PX, CaptureController, ImageRequest
from gsrain_engine.editor.document import Document
from gsrain_engine.editor.drive import RolloutPlayer
from gsrain_engine.editor.make_rainy import WetLookController
from gsrain_engine.editor.matching import MatchingController, MatchResult
from gsrain_engine.editor.overlays import (
    Frustum,
    KeyHandle,
    frustums,
    hardly_visible_selection,
    image_grid,
    path_overlay_of,
)
from gsrain_engine.editor.overlays_drive import BoxMark, DetectionBox, detection_boxes, rollout_overlay
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.editor.viewport.picking import project_lines, project_point
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.render.plan_marks import COLORS as MARK_COLORS
from gsrain_engine.render.plan_marks import bar_line, mark_lines, scale_bar
from gsrain_engine.simulation.metrics.collisions import LONGEST_S

from ..widgets.draw import CHOSEN, KEY, OUTLINE, PLAYHEAD, Canvas, color, draw_card, draw_dot, draw_hint, draw_lines
from ..widgets.text import visible_name

Overlay = Callable[..., bool]
"""Draws into the window's draw list; returns True if it uses the left mouse button now (a handle is dragged).

Gets `canvas` and the editor's parts that its parameters name.
"""

Grid = Float64[np.ndarray, "rows columns 2"]
"""Viewport pixels of the corners of an image's cells."""

_LEFT = imgui.MouseButton_.left
_MARGIN = 10.0
_PAPER = ImVec4(0.06, 0.065, 0.08, 0.8)
_INK = ImVec4(0.94, 0.94, 0.96, 1.0)
_FAINT = ImVec4(0.7, 0.71, 0.75, 1.0)

# Marks of an orthographic view


def plan_overlay(rollouts: RolloutPlayer, viewport: ViewportState, canvas: Canvas) -> bool:
    """Draw grid, scale bar, boxes and paths over a view to scale, of the traffic that it shows."""
    marks = viewport.marks
    if not marks or not canvas.shot.camera.is_orthographic:
        return False
    found, bar = mark_lines(rollouts.displayed_scene, canvas.shot, marks), scale_bar(canvas.shot.camera)
    left = bottom = 0.0
    if "scale" in marks:
        tall = 1.5 * imgui.get_font_size() + _MARGIN
        left, above = canvas.corner_block(bar.length_px + _MARGIN, tall)
        bottom = above + tall - _MARGIN
        found.append(bar_line(bar, left, bottom))
    for mark, group in groupby(found, key=lambda each: each.mark):
        red, green, blue = (value / 255 for value in MARK_COLORS[mark])
        ink = ImVec4(red, green, blue, 0.35 if mark == "grid" else 0.95)
        lines = [ends for each in group for ends in pairwise(each.points_px.tolist())]
        draw_lines(canvas, lines, ink, 1.0 if mark == "grid" else 1.8, outline=0.0 if mark == "grid" else 1.5)
    if "scale" in marks:
        place = canvas.on_screen(left, bottom - 1.4 * imgui.get_font_size())
        draws = imgui.get_window_draw_list()
        draws.add_text(ImVec2(place.x + 1, place.y + 1), color(OUTLINE), bar.label)
        draws.add_text(place, color(_INK), bar.label)
    return False


# Camera path

_PATH_COLOR = ImVec4(0.55, 0.78, 1.0, 0.9)
_HANDLE_PX, _REACH_PX = 5.5, 10.0
_DRAG_PX = 2.0


def path_overlay(viewport: ViewportState, playback: Playback, camera_path: CameraPathEditor, canvas: Canvas) -> bool:
    """Draw the path, unless the camera rides along it; returns True if a keyframe is dragged or under the mouse."""
    timeline = playback.timeline
    is_dragged = timeline.drag is not None and timeline.drag.in_view
    if not timeline.show_path or viewport.options.follow_path:
        return False
    drawing = path_overlay_of(viewport, canvas.shot.camera)
    if drawing is None:
        return False
    draw_lines(canvas, drawing.path_px.tolist(), _PATH_COLOR, 2.0, outline=1.5)
    for x, y in drawing.ticks_px.tolist():
        imgui.get_window_draw_list().add_circle_filled(canvas.on_screen(x, y), 2.5, color(_PATH_COLOR))
    draw_lines(canvas, drawing.now_px.tolist(), PLAYHEAD, 1.5, outline=1.5)
    under: int | None = None
    if viewport.options.tool == "" or is_dragged:
        near = [mark.key for mark in drawing.keys if canvas.is_mouse_near(mark.handle_px, _REACH_PX)]
        under = near[-1] if near else None  # drawn last
    for mark in drawing.keys:
        _draw_keyframe(camera_path, canvas, mark, is_near=mark.key == under)
    if is_dragged:
        _drag_keyframe(playback, camera_path, canvas)
        return True
    if under is None or not canvas.hovered:
        return False
    imgui.set_tooltip(
        f"Keyframe {under + 1}. Drag: move it in the plane that faces you. Shift+drag: up and down. Click: choose it."
    )
    if imgui.is_mouse_clicked(_LEFT):
        camera_path.begin_drag(under, in_view=True)
    return True


def _draw_keyframe(camera_path: CameraPathEditor, canvas: Canvas, mark: KeyHandle, *, is_near: bool) -> None:
    hue = CHOSEN if camera_path.active_key == mark.key else KEY
    draw_lines(canvas, mark.frustum_px.tolist(), hue, 1.5, outline=1.5)
    radius = _HANDLE_PX + (2 if is_near else 0)
    draw_dot(canvas, mark.handle_px, hue, radius)
    at = canvas.on_screen(*mark.handle_px)
    low = at.y + 0.35 * imgui.get_font_size()
    for offset, ink in ((1.0, OUTLINE), (0.0, hue)):
        corner = ImVec2(at.x + radius + 3 + offset, low + offset)
        imgui.get_window_draw_list().add_text(corner, color(ink), str(mark.key + 1))


def _drag_keyframe(playback: Playback, camera_path: CameraPathEditor, canvas: Canvas) -> None:
    drag, moved = playback.timeline.drag, imgui.get_mouse_drag_delta(_LEFT, _DRAG_PX)
    if drag is None:
        return
    if moved.x or moved.y:
        playback.timeline.drag = drag = drag._replace(has_moved=True)
    if drag.has_moved:
        camera_path.drag_in_view(canvas.shot, (moved.x, moved.y), upright=imgui.get_io().key_shift)
    if not imgui.is_mouse_down(_LEFT):
        camera_path.end_drag()


# Capture

_CAMERA = ImVec4(0.5, 0.85, 0.62, 0.9)
_CAMERA_PX, _CAMERA_REACH_PX = 4.0, 9.0
_IMAGES = 24  # number of nearest cameras that show their images


def capture_overlay(document: Document, viewport: ViewportState, captures: CaptureController, canvas: Canvas) -> bool:
    """Draw the visible parts of the capture; returns True if the mouse is over one of its cameras."""
    captures.viewport_px = canvas.width, canvas.height
    if captures.capture is None:
        return False
    here = captures.view_at_camera
    if here is not None:
        _draw_recorded_image(document, captures, canvas, here)
    if captures.points_texture is not None:
        low, high = canvas.corner, canvas.on_screen(canvas.width, canvas.height)
        imgui.get_window_draw_list().add_image(imgui.ImTextureRef(captures.points_texture.name), low, high)
    if here is not None or not captures.show_frustums:  # from inside, frustums would hide the compared images
        return False
    cameras = captures.cameras(document.scene)
    found = frustums(cameras, captures.listed, captures.length_m(document.scene), canvas.shot.camera)
    under: Frustum | None = None
    if canvas.hovered and viewport.options.tool == "":
        near = [each for each in found if each.eye_px and canvas.is_mouse_near(each.eye_px, _CAMERA_REACH_PX)]
        under = near[-1] if near else None
    for number, each in enumerate(found):
        if number >= len(found) - _IMAGES:
            _draw_image(document, captures, canvas, each.view, THUMBNAIL_PX, 1.0)
        is_chosen = captures.chosen == each.view
        hue = CHOSEN if is_chosen or under is each else _CAMERA
        draw_lines(canvas, each.lines_px.tolist(), hue, 2.0 if is_chosen else 1.0)
        if each.eye_px is not None:
            draw_dot(canvas, each.eye_px, hue, _CAMERA_PX + 2 * (under is each))
    if under is None:
        return False
    view = captures.capture[under.view]
    moment = f", {view.time_s:.2f} s" if captures.has_times else ""
    imgui.set_tooltip(f"{view.name}{moment}. Click: choose it. Double click: look from there.")
    if imgui.is_mouse_double_clicked(_LEFT):
        captures.look_from(under.view)
    elif imgui.is_mouse_clicked(_LEFT):
        captures.chosen = under.view
    return True


def _draw_recorded_image(document: Document, captures: CaptureController, canvas: Canvas, view: int) -> None:
    camera = captures.cameras(document.scene)[view]
    if captures.show_picture and captures.opacity > 0:
        is_there = ImageRequest(view, LARGE_PX) in captures.textures
        if captures.pictures is not None:
            captures.pictures.want(view, LARGE_PX)
        _draw_image(document, captures, canvas, view, LARGE_PX if is_there else THUMBNAIL_PX, captures.opacity)
    grid = image_grid(camera, captures.length_m(document.scene), canvas.shot.camera, (1, 1))
    if grid is not None:
        a, b, d, c = (canvas.on_screen(x, y) for x, y in grid.reshape(4, 2).tolist())
        imgui.get_window_draw_list().add_quad(a, b, c, d, color(CHOSEN), 1.5)


def _draw_image(
    document: Document, captures: CaptureController, canvas: Canvas, view: int, width: int, opacity: float
) -> None:
    """Draw a recorded image in its camera's frustum."""
    if captures.pictures is None:
        return
    camera = captures.cameras(document.scene)[view]
    captures.pictures.want(view, width)
    texture = captures.textures.get(ImageRequest(view, width))
    cells = (4, 3) if width == THUMBNAIL_PX else (8, 6)
    grid = image_grid(camera, captures.length_m(document.scene), canvas.shot.camera, cells)
    if texture is not None and grid is not None:
        _draw_placed_image(canvas, texture.name, grid, opacity)


def _draw_placed_image(canvas: Canvas, texture: int, grid: Grid, opacity: float) -> None:
    """Draw a texture (its OpenGL name), first row on top; in cells, since draw lists have no perspective."""
    low, high = grid.min(axis=(0, 1)), grid.max(axis=(0, 1))
    if not (high[0] > 0 and high[1] > 0 and low[0] < canvas.width and low[1] < canvas.height):
        return
    draw, tint = imgui.get_window_draw_list(), imgui.get_color_u32(ImVec4(1.0, 1.0, 1.0, opacity))
    on_screen = [[canvas.on_screen(x, y) for x, y in row] for row in grid.tolist()]
    rows, columns = len(on_screen) - 1, len(on_screen[0]) - 1
    for row in range(rows):
        for column in range(columns):
            corners = [(row, column), (row, column + 1), (row + 1, column + 1), (row + 1, column)]
            places = [on_screen[down][right] for down, right in corners]
            shares = [ImVec2(right / columns, down / rows) for down, right in corners]
            draw.add_image_quad(imgui.ImTextureRef(texture), *places, *shares, tint)


# Matching

_WORDS: dict[MatchOutcome, str] = {
    MatchOutcome.MATCHED: "matched", MatchOutcome.HIDDEN: "hidden there", MatchOutcome.EDGE: "edge of something",
    MatchOutcome.MOVING: "may have moved", MatchOutcome.UNKNOWN: "depth unknown",
    MatchOutcome.OUTSIDE: "outside that view",
}  # fmt: skip
_CELLS = (8, 6)
_MIN_SHARE = 0.005  # minimum share of the image for an entry in the legend
_LINE = ImVec4(0.35, 0.95, 0.6, 0.85)
_INSET_SHARE, _MAX_INSET_EM = 0.3, 16.0
_LEGEND_PAPER = ImVec4(0.06, 0.065, 0.08, 0.82)


def matching_overlay(captures: CaptureController, matching: MatchingController, canvas: Canvas) -> bool:
    """Draw the match with another view, if enabled; never uses the mouse."""
    if not matching.is_on:
        return False
    result = matching.shown
    if result is None:
        _draw_legend(canvas, matching.why_none or "Matching...", [])
        return False
    grid = image_grid(result.camera, 1.0, canvas.shot.camera, _CELLS)
    if matching.texture is None or grid is None:
        return False
    _draw_placed_image(canvas, matching.texture.name, grid, 1.0)
    if matching.lines:
        starts, ends = (_on_grid(result.lines[:, k], grid).tolist() for k in (0, 1))
        for start, end in zip(starts, ends, strict=True):
            draw_lines(canvas, [(start, end)], _LINE, 1.3, outline=1.7)
            draw_dot(canvas, start, _LINE, 1.6, outline=0.8)
    _draw_other_view(captures, canvas, result, _match_under_mouse(canvas, result, grid))
    named = [each for each in result.shares.items() if each[1] >= _MIN_SHARE]
    if matching.mode != "pixels":  # matches have their own colors, and the title has their share
        named = [each for each in named if each[0] != MatchOutcome.MATCHED]
    title = f"{result.matched.found.valid.mean():.0%} matched with {result.matched.to.name}"
    _draw_legend(canvas, title, named)
    return False


def _on_grid(shares: np.ndarray, grid: Grid) -> Float64[np.ndarray, "n 2"]:
    """Return viewport pixels at relative positions of the image; the image's corners are those of the grid."""
    x, y = shares[:, :1].astype(np.float64), shares[:, 1:].astype(np.float64)
    top = (1 - x) * grid[0, 0] + x * grid[0, -1]
    bottom = (1 - x) * grid[-1, 0] + x * grid[-1, -1]
    return (1 - y) * top + y * bottom


def _match_under_mouse(canvas: Canvas, result: MatchResult, grid: Grid) -> tuple[int, int] | None:
    """Return row and column of the matched image under the mouse; None outside it."""
    if not canvas.hovered:
        return None
    height, width = result.matched.found.outcome.shape
    right, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    share = np.linalg.solve(np.stack([right, down], axis=1), np.array(canvas.mouse_px) - grid[0, 0])
    column, row = int(np.floor(share[0] * width)), int(np.floor(share[1] * height))
    return (row, column) if 0 <= row < height and 0 <= column < width else None


def _draw_other_view(
    captures: CaptureController, canvas: Canvas, result: MatchResult, under: tuple[int, int] | None
) -> None:
    """Draw the other view in the corner, with a cross at the pixel that matches the mouse position."""
    other = result.matched.to
    if captures.pictures is None:
        return
    captures.pictures.want(result.request.to, THUMBNAIL_PX)
    texture = captures.textures.get(ImageRequest(result.request.to, THUMBNAIL_PX))
    if texture is None:
        return
    width = min(_INSET_SHARE * canvas.width, _MAX_INSET_EM * imgui.get_font_size())
    height = width * other.camera.height / other.camera.width
    low = canvas.on_screen(canvas.width - width - _MARGIN, canvas.edges.top + _MARGIN)
    high = ImVec2(low.x + width, low.y + height)
    draw = imgui.get_window_draw_list()
    draw.add_image(imgui.ImTextureRef(texture.name), low, high)
    draw.add_rect(low, high, color(CHOSEN), thickness=1.5)
    if under is None:
        return
    outcome = MatchOutcome(int(result.matched.found.outcome[under]))
    if outcome != MatchOutcome.MATCHED:
        imgui.set_tooltip(f"No match in {other.name}: {_WORDS[outcome]}.")
        return
    x, y = result.matched.found.places[under].tolist()
    at = ImVec2(low.x + x / other.camera.width * width, low.y + y / other.camera.height * height)
    for ink, thick in ((OUTLINE, 3.5), (CHOSEN, 1.5)):
        draw.add_line(ImVec2(at.x - 7, at.y), ImVec2(at.x + 7, at.y), color(ink), thick)
        draw.add_line(ImVec2(at.x, at.y - 7), ImVec2(at.x, at.y + 7), color(ink), thick)
    imgui.set_tooltip(f"There at column {x:.1f}, row {y:.1f} of {other.camera.width} x {other.camera.height} px.")


def _draw_legend(canvas: Canvas, title: str, shares: list[tuple[MatchOutcome, float]]) -> None:
    """Draw the legend in the lower right corner; tools are on the left."""
    draw, em = imgui.get_window_draw_list(), imgui.get_font_size()
    line = imgui.get_text_line_height() * 1.2
    rows = [f"{_WORDS[each]}  {share:.0%}" for each, share in shares]
    width = max([imgui.calc_text_size(title).x, *(imgui.calc_text_size(row).x + 1.4 * em for row in rows)]) + 1.2 * em
    height = (1 + len(rows)) * line + 0.8 * em
    low = canvas.on_screen(*canvas.corner_block(width, height))
    draw.add_rect_filled(low, ImVec2(low.x + width, low.y + height), color(_LEGEND_PAPER), 5.0)
    x, y = low.x + 0.6 * em, low.y + 0.4 * em
    draw.add_text(ImVec2(x, y), color(_INK), title)
    for (outcome, _), row in zip(shares, rows, strict=True):
        y += line
        box = ImVec2(x, y + 0.2 * em), ImVec2(x + 0.8 * em, y + em)
        draw.add_rect_filled(*box, color((*COLORS[outcome], 1.0)), 2.0)
        draw.add_rect(*box, color(_FAINT), 2.0)
        draw.add_text(ImVec2(x + 1.4 * em, y), color(_FAINT), row)


# Roll-out

_PLAN = ImVec4(0.2, 0.95, 0.6, 1.0)
_DRIVEN = ImVec4(0.45, 0.78, 1.0, 0.55)
_USER = ImVec4(1.0, 0.74, 0.3, 0.95)
_EGO = ImVec4(0.45, 0.78, 1.0, 0.95)
_HIT = ImVec4(1.0, 0.3, 0.25, 1.0)
_DETECTION_COLOR = ImVec4(1.0, 0.5, 0.85, 0.95)
_ENDS = {
    "time": "The time of the scenario is over", "completed": "The end of the route",
    "off route": "Too far off the route", "agent": "The agent has ended the drive", "stopped": "The drive was stopped",
}  # fmt: skip


def drive_overlay(
    document: Document, viewport: ViewportState, playback: Playback, rollouts: RolloutPlayer, canvas: Canvas
) -> bool:
    """Draw the roll-out at the current time; never uses the mouse."""
    rollout = rollouts.placed_in(document.scene)
    if rollout is None:
        return False
    inside = viewport.chase.mode == "front camera"
    drawing = rollout_overlay(rollout, playback.clock.time_s, canvas.shot.camera, from_inside=inside)
    if rollouts.show_plan:
        draw_lines(canvas, drawing.driven_px.tolist(), _DRIVEN, 2.0)
        draw_lines(canvas, drawing.plan_px.tolist(), _PLAN, 2.5, outline=2.0)
        for x, y, radius in drawing.dots:
            draw_dot(canvas, (x, y), _PLAN, radius)
    if rollouts.show_boxes:
        for box in drawing.boxes:
            _draw_box(canvas, box)
    if rollouts.show_boxes and inside and rollout.front_camera is not None:
        step = rollout.played.step(rollout.own_time_s(playback.clock.time_s))
        for detection in detection_boxes(step, rollout.front_camera, canvas.shot.camera):
            _draw_detection(canvas, detection)
    _draw_figures(document, playback, rollouts, canvas)
    return False


def _draw_box(canvas: Canvas, box: BoxMark) -> None:
    hue = _HIT if box.is_hit else _EGO if box.is_ego else _USER
    draw_lines(canvas, box.lines_px.tolist(), hue, 2.0 if box.is_hit else 1.3)
    if box.top_px is None or box.is_ego:
        return
    words, (x, y) = f"{box.name}  {box.speed_m_s:.1f} m/s", box.top_px
    size = imgui.calc_text_size(words)
    draw_card(words, canvas.on_screen(x - size.x / 2, y - size.y - 10), hue, _PAPER, (5, 2))


def _draw_detection(canvas: Canvas, box: DetectionBox) -> None:
    hue = _PLAN if box.is_lead else _DETECTION_COLOR
    low, high = canvas.on_screen(*box.low_px), canvas.on_screen(*box.high_px)
    thick = 2.0 if box.is_lead else 1.2
    imgui.get_window_draw_list().add_rect(low, high, color(hue), 2.0, thickness=thick)
    draw_card(box.words, ImVec2(low.x + 4, high.y + 2), hue, _PAPER, (4, 0), 3.0)


def _draw_figures(document: Document, playback: Playback, rollouts: RolloutPlayer, canvas: Canvas) -> None:
    """Draw the ego vehicle's current state at the lower edge; above it, the collision."""
    step, playing, rollout = rollouts.step_now, rollouts.playing, rollouts.placed_in(document.scene)
    if step is None or playing is None or rollout is None:
        return
    time_s = rollout.own_time_s(playback.clock.time_s)
    state, ttc_s = rollout.played.state(time_s), playing.curves.ttc_at(time_s)
    words = [
        f"{time_s:.2f} s",
        f"{state.speed_m_s:.1f} m/s",
        f"{step.ego.acceleration_m_s2:z.1f} m/s\u00b2",
        f"TTC {ttc_s:.1f} s" if ttc_s < LONGEST_S else f"TTC {LONGEST_S:g} s or more",
    ]
    draw_hint(canvas, "    ".join(words), _INK)
    if step.collision is not None:
        draw_hint(canvas, f"Hits {step.collision} at {step.ego.speed_m_s:.1f} m/s", _HIT)
    elif time_s >= rollout.played.end_s:
        draw_hint(canvas, _ENDS.get(playing.rollout.end, playing.rollout.end), _FAINT)


# Lamps

_LAMP_PX, _LAMP_REACH_PX, _AXIS_PX = 5.0, 9.0, 30.0
_LAMP = ImVec4(1.0, 0.86, 0.4, 1.0)


def lamp_overlay(document: Document, viewport: ViewportState, canvas: Canvas) -> bool:
    """Mark the scene's lamps, with the axis of the chosen one; returns True if the mouse is over a lamp."""
    scene, shot, options = document.scene, canvas.shot, viewport.options
    if not options.show_lamps or not scene.lamps:
        return False
    under: int | None = None
    for number, lamp in enumerate(scene.lamps):
        lit = scene.lamps_at(shot.time_s, (lamp,))
        if not len(lit.positions_m) or (at := project_point(lit.positions_m[0], shot.camera)) is None:
            continue
        is_chosen = number == options.lamp
        if is_chosen:
            length_m = _AXIS_PX * at.depth_m / shot.camera.fy
            axis = np.stack([lit.positions_m, lit.positions_m + length_m * lit.directions], axis=1)
            draw_lines(canvas, project_lines(axis, shot.camera).tolist(), CHOSEN, 1.5, outline=1.5)
        draw_dot(canvas, (at.x, at.y), CHOSEN if is_chosen else _LAMP, _LAMP_PX)
        if options.tool == "" and canvas.is_mouse_near((at.x, at.y), _LAMP_REACH_PX):
            under = number
    if under is None or not canvas.hovered:
        return False
    imgui.set_tooltip(f"{visible_name(scene.lamps[under].name) or 'lamp'}. Click: choose it.")
    if imgui.is_mouse_clicked(_LEFT):
        options.lamp = under
    return True


# Selection

_CENTER = ImVec4(1.0, 0.82, 0.15, 1.0)  # as the tint


def selection_overlay(document: Document, viewport: ViewportState, canvas: Canvas) -> bool:
    """Mark the centers of selected Gaussians of which a tint shows nothing, such as those of faint floaters."""
    if viewport.options.show_selection:
        shot = canvas.shot
        for pixel in hardly_visible_selection(document.scene, shot.time_s, shot.camera).tolist():
            draw_dot(canvas, pixel, _CENTER, 2.0, 1.0)
    return False


OVERLAYS: tuple[Overlay, ...] = (
    plan_overlay, capture_overlay, matching_overlay, path_overlay, lamp_overlay, drive_overlay, selection_overlay,
)  # fmt: skip

# Divider of two images

_GRIP_PX = 6.0  # half its width
_LABEL_PX = 8.0  # margin of the labels
_SPIN_RAD_S, _SPINNER_RAD = 5.0, 4.5


def draw_divider(
    viewport: ViewportState, labels: tuple[str, str], corner: ImVec2, width: int, height: int, below: float
) -> None:
    """Draw the draggable divider with the labels of both images, which begin `below` pixels from the top.

    A double click centers it.
    """
    view = viewport.options
    x = corner.x + view.divider * width
    imgui.set_cursor_screen_pos(ImVec2(x - _GRIP_PX, corner.y))
    imgui.invisible_button("divider", ImVec2(2 * _GRIP_PX, height))
    held, hovered = imgui.is_item_active(), imgui.is_item_hovered()
    if held or hovered:
        imgui.set_mouse_cursor(imgui.MouseCursor_.resize_ew)
    if held:
        view.divider = min(max(view.divider + imgui.get_io().mouse_delta.x / width, 0.0), 1.0)
    if hovered and imgui.is_mouse_double_clicked(_LEFT):
        view.divider = 0.5
    x, draw = corner.x + view.divider * width, imgui.get_window_draw_list()
    draw.push_clip_rect(corner, ImVec2(corner.x + width, corner.y + height), True)
    ink = color((1.0, 1.0, 1.0, 1.0 if held or hovered else 0.75))
    draw.add_line(ImVec2(x, corner.y), ImVec2(x, corner.y + height), ink, 2.0)
    draw.add_circle_filled(ImVec2(x, corner.y + height / 2), 7.0, ink)
    left = x - imgui.calc_text_size(labels[0]).x - 2 * _LABEL_PX
    for label, at in zip(labels, (left, x + 2 * _LABEL_PX), strict=True):
        paper = (0.0, 0.0, 0.0, 0.55)
        draw_card(label, ImVec2(at, corner.y + below + _LABEL_PX), paper=paper, padding=(5, 2), rounding=3.0)
    draw.pop_clip_rect()


def draw_spinner(center: ImVec2) -> None:
    """Draw a turning arc where a picture is still being drawn."""
    draw, turn = imgui.get_window_draw_list(), _SPIN_RAD_S * imgui.get_time()
    for ink, thickness in ((OUTLINE, 6.0), (KEY, 3.0)):
        draw.path_arc_to(center, 0.8 * imgui.get_font_size(), turn, turn + _SPINNER_RAD)
        draw.path_stroke(color(ink), thickness)


def preview_side(
    viewport: ViewportState, wet_look: WetLookController, corner: ImVec2, width: int, height: int
) -> tuple[str, str] | None:
    """Draw the preview over the right part of the viewport; returns the labels of both images, or None."""
    wet_look.viewport_px = width, height
    texture = wet_look.textures.get("rainy")
    if viewport.options.split != "now | preview" or texture is None or not wet_look.fits:
        return None
    at = viewport.options.divider
    low, high = ImVec2(corner.x + at * width, corner.y), ImVec2(corner.x + width, corner.y + height)
    imgui.get_window_draw_list().add_image(imgui.ImTextureRef(texture.name), low, high, ImVec2(at, 0))
    return "now", "preview, soaked"
