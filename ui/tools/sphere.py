"""Select by a ball placed in the world."""

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.selection.volumes import Ball
from gsrain_engine.session.session import Session
from gsrain_engine.session.view.picking import pick_point

from ..widgets.markers import draw_hint, draw_point
from ..widgets.viewport import Viewport
from . import outline
from .box_faces import is_pressed
from .left_drag import LeftDrag
from .selecting import MODIFIERS, apply_volume, beside, mode_options, volume_buttons

_FIRST_RADIUS_M = 1.0
_RING = 64


class SphereTool:
    """Click a surface for the centre, drag for the radius, apply."""

    name = "Sphere"
    icon = icons_fontawesome_6.ICON_FA_GLOBE
    key: imgui.Key | None = imgui.Key.o
    help = f"Press on a surface for the centre, drag for the radius; Enter selects what is inside. {MODIFIERS}"

    def __init__(self) -> None:
        self._drag = LeftDrag()
        self._radius_m = _FIRST_RADIUS_M

    def draw(self, session: Session, viewport: Viewport) -> bool:
        options = session.selecting
        if is_pressed(viewport):
            point = pick_point(session.scene, viewport.shot, *viewport.mouse_px)
            if point is not None:
                x, y, z = point.tolist()
                options.ball = Ball((x, y, z), self._radius_m)
        state = self._drag.follow(viewport)
        if state == "dragged" and self._drag.has_moved and options.ball is not None:
            options.ball = options.ball.reaching(*viewport.ray(*viewport.mouse_px))
            self._radius_m = options.ball.radius_m
        elif state == "released":
            self._drag.drop()
        if options.ball is None:
            draw_hint(viewport, "Press on a surface for the centre, drag for the radius")
            return True
        _draw_ball(viewport, options.ball)
        draw_hint(viewport, "Enter selects what is inside; press elsewhere to place it anew")
        apply_volume(session, viewport.shot.time_s, options.ball, "sphere")
        return True

    def options(self, session: Session) -> None:
        options = session.selecting
        mode_options(session)
        ball = options.ball
        if ball is None:
            return
        beside(13)
        em = imgui.get_font_size()
        imgui.set_next_item_width(13 * em)
        moved, center = imgui.drag_float3("##center", list(ball.center_m), 0.02, -1e5, 1e5, "%.2f")
        imgui.set_item_tooltip("Centre of the sphere in the world: x, y, z in metres.")
        beside(7)
        imgui.set_next_item_width(7 * em)
        flags = imgui.SliderFlags_.always_clamp | imgui.SliderFlags_.logarithmic
        sized, radius = imgui.drag_float("##radius_m", ball.radius_m, 0.01, 0.01, 1e4, "radius %.2f m", flags)
        imgui.set_item_tooltip("Radius of the sphere in metres.")
        if moved or sized:
            options.ball = Ball((center[0], center[1], center[2]), radius)
            self._radius_m = radius
        if volume_buttons(session, options.ball or ball, "sphere"):
            options.ball = None


def _draw_ball(viewport: Viewport, ball: Ball) -> None:
    """Draw its three great circles, and a dot in the middle."""
    for circle in ball.circles_m(_RING):
        pixels = [viewport.pixel(point) for point in circle]
        seen = [pixel for pixel in pixels if pixel is not None]
        if len(seen) == len(pixels):
            outline.line(viewport, seen, closed=True)
    draw_point(viewport, ball.middle, radius=4)
