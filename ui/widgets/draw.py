"""Drawing: colors, the viewport's coordinates, plots, and the transform gizmo."""

import math
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui, imguizmo, implot
from jaxtyping import Float64

from gsrain_engine.editor.viewport import picking
from gsrain_engine.editor.viewport.options import Texture
from gsrain_engine.render.view import RenderView

from .text import visible_name

Rgba = tuple[float, float, float, float]
Color = ImVec4 | Rgba | int
"""A color; a number is a style color (`imgui.Col_`), which follows the theme."""

KEY = ImVec4(0.93, 0.93, 0.95, 1.0)
CHOSEN = ImVec4(1.0, 0.66, 0.2, 1.0)
PLAYHEAD = ImVec4(0.95, 0.33, 0.28, 1.0)
PLAYED = ImVec4(0.38, 0.6, 0.85, 1.0)
FLIGHT = ImVec4(0.38, 0.6, 0.85, 0.45)
TOO_FAST = ImVec4(0.95, 0.33, 0.28, 0.75)
RAIN = ImVec4(0.45, 0.85, 1.0, 1.0)
PRESENT = ImVec4(0.45, 0.7, 0.5, 0.6)
OUTLINE = ImVec4(0.0, 0.0, 0.0, 0.65)
DIM = int(imgui.Col_.text_disabled)
FAINT = int(imgui.Col_.separator)
BACKGROUND = int(imgui.Col_.frame_bg)
STRIPE = int(imgui.Col_.table_row_bg_alt)
TEXT = int(imgui.Col_.text)
WHITE: Rgba = (1.0, 1.0, 1.0, 1.0)
YELLOW: Rgba = (1.0, 0.85, 0.25, 1.0)
_SHADOW: Rgba = (0.0, 0.0, 0.0, 0.65)
_SMALLEST_M = 0.01
EDGE_MARGIN = 10.0
"""Pixels between the edge of the viewport and what lies there."""
_LINE_GAP = 4.0


def color(value: Color) -> int:
    """Return the number of a color for draw lists."""
    return imgui.get_color_u32(imgui.get_style_color_vec4(value) if isinstance(value, int) else value)


# Viewport coordinates


@dataclass
class FreeEdges:
    """Room that is left at the edges of the viewport in this frame, in pixels: what is placed there takes its part."""

    top: float = 0.0
    """Height of the bars at the upper edge."""
    left: float = 0.0
    """Width of the bar or card at the left end of the lower edge."""
    right: float = 0.0
    """Width of the blocks in the lower right corner."""
    corner: float = 0.0
    """Height of these blocks."""
    lines: float = 0.0
    """Height of the lines of text at the lower edge."""
    max_bottom: float = math.inf
    """Maximum of both heights, by which the middle of the viewport and notices have room."""

    @property
    def bottom(self) -> float:
        """Height that all of the lower edge takes, right of its left end."""
        return max(self.corner, self.lines)


@dataclass(frozen=True)
class Canvas:
    """Viewport of this frame, for tools and overlays. Pixels count from its upper left corner."""

    corner: ImVec2
    """Screen position."""
    width: int
    height: int
    shot: RenderView
    """Rendered view: a camera of this size, in the world (meters)."""
    hovered: bool
    """True if the mouse is over the viewport, with nothing on top."""
    active: bool
    """True while a mouse button that was pressed over the viewport is held."""
    edges: FreeEdges = field(default_factory=FreeEdges)

    @property
    def mouse_px(self) -> tuple[float, float]:
        at = imgui.get_mouse_pos()
        return at.x - self.corner.x, at.y - self.corner.y

    def is_mouse_near(self, pixel: tuple[float, float], reach_px: float) -> bool:
        """Return True if the mouse is in the square around a pixel that reaches so far to each side."""
        x, y = self.mouse_px
        return max(abs(pixel[0] - x), abs(pixel[1] - y)) <= reach_px

    def on_screen(self, x: float, y: float) -> ImVec2:
        return ImVec2(self.corner.x + x, self.corner.y + y)

    def corner_block(self, width: float, height: float) -> tuple[float, float]:
        """Return the upper left pixel of a block in the lower right corner, above those that are there already."""
        edges = self.edges
        edges.corner += height + EDGE_MARGIN
        edges.right = max(edges.right, width + EDGE_MARGIN)
        return self.width - width - EDGE_MARGIN, self.height - edges.corner

    def ray(self, x: float, y: float) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
        """Return camera position and unit direction, in the world, of the ray through a pixel."""
        camera = self.shot.camera
        sight = np.array([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0])
        direction = camera.world_to_camera[:3, :3].T @ sight
        return camera.position, direction / np.linalg.norm(direction)

    def size_m(self, share: float, point_m: Float64[np.ndarray, "3"]) -> float:
        """Return the length that covers a share of the viewport's height at a point's depth, in two digits."""
        camera = self.shot.camera
        depth_m = float(camera.world_to_camera[2, :3] @ point_m + camera.world_to_camera[2, 3])
        return float(f"{max(share * self.height / camera.fy * depth_m, _SMALLEST_M):.2g}")

    def pixel(self, point_m: Float64[np.ndarray, "3"]) -> tuple[float, float] | None:
        """Return the pixel of a world point; None behind the camera."""
        projected = picking.project_point(point_m, self.shot.camera)
        return projected and (projected.x, projected.y)


# Points, lines and text at positions of the world, and of the viewport


def draw_point(canvas: Canvas, point_m: Float64[np.ndarray, "3"], color: Rgba = YELLOW, radius: float = 5) -> None:
    """Draw a dot; nothing behind the camera."""
    pixel = canvas.pixel(point_m)
    if pixel is not None:
        draw_dot(canvas, pixel, color, radius, shadow=_SHADOW)


def draw_line(
    canvas: Canvas, start_m: Float64[np.ndarray, "3"], end_m: Float64[np.ndarray, "3"], color: Rgba = YELLOW
) -> None:
    """Draw a straight line; nothing if one end is behind the camera."""
    start, end = canvas.pixel(start_m), canvas.pixel(end_m)
    if start is not None and end is not None:
        draw_lines(canvas, [(start, end)], color, 2.0, outline=2.0, shadow=_SHADOW)


def draw_words(canvas: Canvas, point_m: Float64[np.ndarray, "3"], words: str) -> None:
    pixel = canvas.pixel(point_m)
    if pixel is not None:
        at = canvas.on_screen(*pixel)
        draw_card(words, ImVec2(at.x + 10, at.y - 0.5 * imgui.get_font_size()))


def draw_hint(canvas: Canvas, words: str, ink: Color = (1.0, 1.0, 1.0, 0.95)) -> None:
    """Draw text in the middle of the room at the lower edge of the viewport, above earlier ones of this frame.

    Nothing in a viewport that is too small for it.
    """
    edges, em = canvas.edges, imgui.get_font_size()
    x, y = 0.7 * em, 0.25 * em
    left, right = edges.left + EDGE_MARGIN + x, canvas.width - edges.right - EDGE_MARGIN - x
    wrap_px = max(right - left, 6 * em)
    size = imgui.calc_text_size(words, False, wrap_px)
    lines = edges.lines + size.y + 2 * y + (EDGE_MARGIN if edges.lines == 0 else _LINE_GAP)
    if lines > edges.max_bottom:
        return
    edges.lines = lines
    at = canvas.on_screen(max(left, (left + right - size.x) / 2), canvas.height - edges.lines + y)
    draw_card(words, at, ink, padding=(x, y), rounding=5.0, wrap_px=wrap_px)


def draw_dot(
    canvas: Canvas, pixel: Sequence[float], hue: Color, radius: float, outline: float = 1.5, shadow: Color = OUTLINE
) -> None:
    draw, at = imgui.get_window_draw_list(), canvas.on_screen(*pixel)
    draw.add_circle_filled(at, radius + outline, color(shadow))
    draw.add_circle_filled(at, radius, color(hue))


def draw_diamond(at: ImVec2, radius: float, hue: Color) -> None:
    """Draw a keyframe at a position on the screen."""
    left, right = ImVec2(at.x - radius, at.y), ImVec2(at.x + radius, at.y)
    above, below = ImVec2(at.x, at.y - radius), ImVec2(at.x, at.y + radius)
    imgui.get_window_draw_list().add_quad_filled(left, above, right, below, color(hue))


def draw_lines(
    canvas: Canvas,
    lines_px: Iterable[Sequence[Sequence[float]]],
    hue: Color,
    width: float,
    *,
    outline: float = 0.0,
    shadow: Color = OUTLINE,
) -> None:
    """Draw lines between pixels of the viewport; `outline` is the additional width of dark lines below all of them."""
    ends = [(canvas.on_screen(*start), canvas.on_screen(*end)) for start, end in lines_px]
    for ink, thick in ((shadow, width + outline), (hue, width))[0 if outline else 1 :]:
        for start, end in ends:
            imgui.get_window_draw_list().add_line(start, end, color(ink), thick)


def draw_card(
    words: str,
    at: ImVec2,
    ink: Color = (1.0, 1.0, 1.0, 0.95),
    paper: Color = _SHADOW,
    padding: tuple[float, float] = (6, 3),
    rounding: float = 4.0,
    wrap_px: float = 0.0,
) -> None:
    """Draw text on a card; `at` is the text's upper left corner on the screen, `wrap_px` the width of its lines."""
    size, draw, (x, y) = imgui.calc_text_size(words, False, wrap_px or -1), imgui.get_window_draw_list(), padding
    low, high = ImVec2(at.x - x, at.y - y), ImVec2(at.x + size.x + x, at.y + size.y + y)
    draw.add_rect_filled(low, high, color(paper), rounding)
    draw.add_text(imgui.get_font(), imgui.get_font_size(), at, color(ink), words, wrap_px)


def draw_image(texture: Texture | None, low: ImVec2, high: ImVec2) -> None:
    """Draw an image between two corners on the screen, or a gray field while there is none."""
    draw = imgui.get_window_draw_list()
    if texture is None:
        draw.add_rect_filled(low, high, color(BACKGROUND))
    else:
        draw.add_image(imgui.ImTextureRef(texture.name), low, high)


def is_clicked(canvas: Canvas) -> bool:
    """Return True for a click over the viewport without dragging, which still orbits."""
    left = imgui.MouseButton_.left
    moved = imgui.get_io().mouse_drag_max_distance_sqr[left]
    return canvas.hovered and imgui.is_mouse_released(left) and moved < 16.0


# Plots in panels

_HEIGHT_EM, _LEGEND_EM = 12.0, 4.5
_LINE_PX, _MARKER_PX = 1.25, 4.0


def on_screen_px(pixels: float) -> float:
    """Return a thickness in pixels of this screen, of which fine ones have more; ImPlot's own sizes don't follow it."""
    return pixels * imgui.get_style().font_scale_dpi


@contextmanager
def plot(
    title: str, x: str, y: str, *, log_x: bool = False, log_y: bool = False, legend: bool = False
) -> Generator[bool]:
    """Begin a plot as wide as the panel; yields True if it can be drawn into. A legend is below it."""
    flags = implot.Flags_.no_menus | implot.Flags_.no_box_select | implot.Flags_.no_mouse_text
    if not legend:
        flags |= implot.Flags_.no_legend
    height = (_HEIGHT_EM + (_LEGEND_EM if legend else 0)) * imgui.get_font_size()
    is_open = implot.begin_plot(title, ImVec2(-1, height), flags)
    if is_open:
        fit = implot.AxisFlags_.auto_fit | implot.AxisFlags_.no_highlight
        implot.setup_axes(x, y, fit, fit)
        if legend:
            implot.setup_legend(implot.Location_.south, implot.LegendFlags_.outside)
        if log_x:
            implot.setup_axis_scale(implot.ImAxis_.x1, implot.Scale_.log10)
        if log_y:
            implot.setup_axis_scale(implot.ImAxis_.y1, implot.Scale_.log10)
    yield is_open
    if is_open:
        implot.end_plot()


_MARKERS = tuple(getattr(implot.Marker_, name) for name in ("circle", "square", "diamond", "up"))


def line(label: str, x: Float64[np.ndarray, " n"], y: Float64[np.ndarray, " n"], series: int) -> None:
    """Draw a curve in the color of a series, by its number, which is the same in every plot."""
    spec = implot.Spec(line_color=implot.get_colormap_color(series), line_weight=on_screen_px(_LINE_PX))
    implot.plot_line(visible_name(label), np.ascontiguousarray(x), np.ascontiguousarray(y), spec=spec)


def points(label: str, x: Float64[np.ndarray, " n"], y: Float64[np.ndarray, " n"], series: int) -> None:
    """Draw points with marker and color of a series, by its number; ImPlot's own choice differs between plots."""
    hue = implot.get_colormap_color(series)
    spec = implot.Spec(
        marker=_MARKERS[series % len(_MARKERS)],
        marker_size=on_screen_px(_MARKER_PX),
        line_color=hue,
        marker_line_color=hue,
        marker_fill_color=hue,
    )
    implot.plot_scatter(visible_name(label), np.ascontiguousarray(x), np.ascontiguousarray(y), spec=spec)


# Transform gizmo (ImGuizmo)

_GIZMO = imguizmo.im_guizmo

_SIZE = 0.17  # share of the viewport
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # to OpenGL's axes: x right, y up, z backward
_STEPS = {"rotate": 15.0, "scale": 0.1}  # degrees and factors that Ctrl snaps to
_STEP_SHARE = 0.05  # of the viewport's height: the step of a move, rounded down to 1, 2 or 5


@dataclass(slots=True)
class Gizmo:
    """A gizmo; `name` distinguishes it from others in the same viewport."""

    name: str
    _start: Float64[np.ndarray, "4 4"] | None = None
    _present: Float64[np.ndarray, "4 4"] | None = None

    def let_go(self) -> None:
        self._start = self._present = None

    def draw(
        self, canvas: Canvas, frame: Float64[np.ndarray, "4 4"], handle: picking.Handle
    ) -> tuple[Float64[np.ndarray, "4 4"] | None, bool]:
        """Draw the gizmo in a frame of the world (meters) and handle the mouse, each frame.

        Returns the similarity of the world resulting from the drag so far, or None if nothing is dragged; and whether
        the gizmo uses the left button now. The drawn frame follows the mouse: `frame` is the start of a drag.
        """
        start = self._start if self._start is not None else frame
        present = self._present if self._present is not None else frame
        _GIZMO.push_id(self.name)
        _GIZMO.begin_frame()
        _GIZMO.set_orthographic(False)
        _GIZMO.set_gizmo_size_clip_space(_SIZE)
        _GIZMO.allow_axis_flip(False)
        _GIZMO.set_drawlist()
        _GIZMO.set_rect(canvas.corner.x, canvas.corner.y, canvas.width, canvas.height)
        matrix = _GIZMO.Matrix16(picking.column_major(present))
        step = _round_step(canvas.size_m(_STEP_SHARE, start[:3, 3])) if handle == "translate" else _STEPS[handle]
        snap = _GIZMO.Matrix3([step] * 3) if imgui.get_io().key_ctrl else None
        camera = canvas.shot.camera
        with _hide_viewport_button(canvas):
            _GIZMO.manipulate(
                _GIZMO.Matrix16(picking.column_major(_FLIP @ camera.world_to_camera)),
                _GIZMO.Matrix16(picking.opengl_projection(camera)),
                _GIZMO.OPERATION[handle],
                _GIZMO.MODE.world if handle != "scale" else _GIZMO.MODE.local,
                matrix,
                None,
                snap,
            )
        held, hovered = _GIZMO.is_using(), _GIZMO.is_over()
        _GIZMO.pop_id()
        if not held:
            self.let_go()
            return None, hovered
        self._start, self._present = start, matrix.values.astype(np.float64).reshape(4, 4).T
        return picking.gizmo_delta(handle, start, self._present), True


def _round_step(length_m: float) -> float:
    """Return the largest length of a ruler (1, 2 or 5 times a power of ten) that is not longer."""
    power = 10.0 ** np.floor(np.log10(length_m))
    return max(each for each in (1.0, 2.0, 5.0) if each * power <= length_m * 1.001) * power


@contextmanager
def _hide_viewport_button(canvas: Canvas) -> Generator[None]:
    """Hide the viewport's own button: ImGuizmo ignores clicks over another item."""
    context = imgui.get_current_context()
    hovered, before, active = context.hovered_id, context.hovered_id_previous_frame, context.active_id
    if canvas.hovered or canvas.active:
        context.hovered_id = context.hovered_id_previous_frame = context.active_id = 0
    yield
    context.hovered_id, context.hovered_id_previous_frame, context.active_id = hovered, before, active
