"""Selection by a box or sphere in the world, and the tool "Crop"."""

from dataclasses import dataclass, replace

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.gaussians import CropBox, box_around, crop
from gsrain_engine.editor.selection.volume import Sphere, placed_on
from gsrain_engine.editor.viewport.picking import pick_point
from gsrain_engine.scene.scene import Scene

from ..widgets.draw import YELLOW, Viewport, draw_hint, draw_line, draw_point
from . import base
from .base import LeftDrag
from .select_screen import MODIFIERS, apply_volume, mode_options, same_line_if_fits, volume_buttons

_FIRST_SIZE_M = (2.0, 2.0, 2.0)


class BoxTool:
    """Click a surface to place the box, drag its faces, apply."""

    name = "Box"
    icon = icons_fontawesome_6.ICON_FA_CUBE
    key: imgui.Key | None = imgui.Key.x
    help = f"Click on a surface, drag the dots on the faces; Enter selects what is inside. {MODIFIERS}"

    def __init__(self) -> None:
        self._held: Face | None = None

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        options = session.selecting
        if is_pressed(viewport):
            self._held = face_under_mouse(viewport, options.box) if options.box is not None else None
            if self._held is None:
                self._place(session, viewport)
        if not viewport.active or not imgui.is_mouse_down(imgui.MouseButton_.left):
            self._held = None
        if self._held is not None and options.box is not None:
            options.box = options.box.pulled(*self._held, *viewport.ray(*viewport.mouse_px))
        if options.box is None:
            draw_hint(viewport, "Click on a surface to put the box there")
            return True
        draw_box(viewport, options.box, self._held)
        draw_hint(viewport, "Drag the dots; Enter selects what is inside; click elsewhere to place it anew")
        apply_volume(session, viewport.shot.time_s, options.box, "box")
        return True

    def options(self, session: Editor) -> None:
        options = session.selecting
        mode_options(session)
        box = options.box
        if box is None:
            return
        same_line_if_fits(14.5)
        em = imgui.get_font_size()
        _word("at")
        imgui.set_next_item_width(12 * em)
        _, center = imgui.drag_float3("##center", list(box.center_m), 0.02, -1e5, 1e5, "%.2f")
        imgui.set_item_tooltip("Middle of the box in the world: x, y, z in metres.")
        same_line_if_fits(14.5)
        _word("size")
        imgui.set_next_item_width(12 * em)
        flags = imgui.SliderFlags_.always_clamp
        _, size = imgui.drag_float3("##size", list(box.size_m), 0.02, 0.01, 1e5, "%.2f", flags)
        imgui.set_item_tooltip("Size of the box along its own x, y, z in metres.")
        same_line_if_fits(7)
        _word("turn")
        imgui.set_next_item_width(4.5 * em)
        _, yaw = imgui.drag_float("##yaw", box.yaw_deg, 0.5, -180.0, 180.0, "%.1f°", flags)
        imgui.set_item_tooltip("Turn of the box to the left, in degrees.")
        options.box = CropBox((center[0], center[1], center[2]), (size[0], size[1], size[2]), yaw)
        if volume_buttons(session, options.box, "box"):
            options.box = None

    def _place(self, session: Editor, viewport: Viewport) -> None:
        """Place the box on the surface under the mouse, in its previous size."""
        point = pick_point(session.scene, viewport.shot, *viewport.mouse_px)
        if point is not None:
            before = session.selecting.box or CropBox((0.0, 0.0, 0.0), _FIRST_SIZE_M)
            session.selecting.box = placed_on(before, point)


def _word(text: str) -> None:
    imgui.align_text_to_frame_padding()
    imgui.text_disabled(text)
    imgui.same_line()


# Sphere

_FIRST_RADIUS_M = 1.0
_RING = 64


class SphereTool:
    """Click a surface for the center, drag for the radius, apply."""

    name = "Sphere"
    icon = icons_fontawesome_6.ICON_FA_GLOBE
    key: imgui.Key | None = imgui.Key.o
    help = f"Press on a surface for the centre, drag for the radius; Enter selects what is inside. {MODIFIERS}"

    def __init__(self) -> None:
        self._drag = LeftDrag()
        self._radius_m = _FIRST_RADIUS_M

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        options = session.selecting
        if is_pressed(viewport):
            point = pick_point(session.scene, viewport.shot, *viewport.mouse_px)
            if point is not None:
                x, y, z = point.tolist()
                options.ball = Sphere((x, y, z), self._radius_m)
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

    def options(self, session: Editor) -> None:
        options = session.selecting
        mode_options(session)
        ball = options.ball
        if ball is None:
            return
        same_line_if_fits(13)
        em = imgui.get_font_size()
        imgui.set_next_item_width(13 * em)
        moved, center = imgui.drag_float3("##center", list(ball.center_m), 0.02, -1e5, 1e5, "%.2f")
        imgui.set_item_tooltip("Centre of the sphere in the world: x, y, z in metres.")
        same_line_if_fits(7)
        imgui.set_next_item_width(7 * em)
        flags = imgui.SliderFlags_.always_clamp | imgui.SliderFlags_.logarithmic
        sized, radius = imgui.drag_float("##radius_m", ball.radius_m, 0.01, 0.01, 1e4, "radius %.2f m", flags)
        imgui.set_item_tooltip("Radius of the sphere in metres.")
        if moved or sized:
            options.ball = Sphere((center[0], center[1], center[2]), radius)
            self._radius_m = radius
        if volume_buttons(session, options.ball or ball, "sphere"):
            options.ball = None


def _draw_ball(viewport: Viewport, ball: Sphere) -> None:
    for circle in ball.circles_m(_RING):
        pixels = [viewport.pixel(point) for point in circle]
        seen = [pixel for pixel in pixels if pixel is not None]
        if len(seen) == len(pixels):
            base.draw_polyline(viewport, seen, closed=True)
    draw_point(viewport, ball.middle, radius=4)


# Box with a dot on each face

Face = tuple[int, bool]
"""Axis, and True for its upper side."""

# Crop


@dataclass(slots=True)
class CropTool:
    """Tool that deletes everything outside a box."""

    name: str = "Crop"
    icon: str = icons_fontawesome_6.ICON_FA_CROP_SIMPLE
    key: imgui.Key | None = None
    help: str = "Drag the faces of the box by their dots, then Apply: what lies outside of it is deleted."
    box: CropBox | None = None
    _scene_name: str = ""
    _held: Face | None = None

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        box = self._box_of(session.scene)
        under = face_under_mouse(viewport, box)
        if under is not None and is_pressed(viewport):
            self._held = under
        if not imgui.is_mouse_down(imgui.MouseButton_.left):
            self._held = None
        if self._held is not None and viewport.active:
            self.box = box = box.pulled(*self._held, *viewport.ray(*viewport.mouse_px))
        draw_box(viewport, box, self._held)
        draw_hint(viewport, "Drag the dots on the faces, then Apply")
        return self._held is not None or under is not None

    def options(self, session: Editor) -> None:
        box = self._box_of(session.scene)
        if imgui.button("Apply##crop"):
            session.edit("Crop to the box", crop, box)
        imgui.set_item_tooltip("Delete what lies outside, of background layers that are shown and not locked.")
        imgui.same_line()
        if imgui.button("Reset##crop"):
            self.box = box_around(session.scene)
        imgui.set_item_tooltip("Put the box around most of what can be seen.")
        imgui.same_line()
        imgui.set_next_item_width(5 * imgui.get_font_size())
        changed, yaw = imgui.drag_float("##yaw", box.yaw_deg, 0.5, -180, 180, "%.1f°")
        imgui.set_item_tooltip("Turn of the box to the left, in degrees.")
        if changed:
            self.box = box = replace(box, yaw_deg=yaw)
        for name, words, value, help_text in (
            ("center_m", "middle", box.center_m, "Middle of the box in the world: x, y, z in metres."),
            ("size_m", "size", box.size_m, "Size of the box along its own x, y, z in metres."),
        ):
            imgui.align_text_to_frame_padding()
            imgui.text(words)
            imgui.same_line(4.2 * imgui.get_font_size())
            imgui.set_next_item_width(15 * imgui.get_font_size())
            low = 0.01 if name == "size_m" else -1e5
            changed, typed = imgui.drag_float3(f"##{name}", list(value), 0.05, low, 1e5, "%.2f", _CLAMP)
            imgui.set_item_tooltip(help_text)
            if changed:
                self.box = box = replace(box, **{name: (typed[0], typed[1], typed[2])})

    def _box_of(self, scene: Scene) -> CropBox:
        if self.box is None or self._scene_name != scene.name:
            self.box, self._scene_name = box_around(scene), scene.name
        return self.box


_CLAMP = imgui.SliderFlags_.always_clamp
_EDGES = [(corner, corner | bit) for corner in range(8) for bit in (1, 2, 4) if not corner & bit]
_FACES: list[Face] = [(axis, upper) for axis in range(3) for upper in (False, True)]
_GRIP_PX = 10.0
_BRIGHT = (1.0, 1.0, 1.0, 1.0)


def draw_box(viewport: Viewport, box: CropBox, held: Face | None) -> None:
    """Draw the edges and the dots; the dragged one, or the one under the mouse, is bright."""
    for first, second in _EDGES:
        draw_line(viewport, box.corners_m[first], box.corners_m[second])
    under = face_under_mouse(viewport, box)
    for face in _FACES:
        is_bright = face in (held, under)
        draw_point(viewport, box.face_m(*face), _BRIGHT if is_bright else YELLOW, 7 if is_bright else 6)


def face_under_mouse(viewport: Viewport, box: CropBox) -> Face | None:
    """Return the face of the dot under the mouse."""
    x, y = viewport.mouse_px
    for face in _FACES if viewport.hovered else ():
        pixel = viewport.pixel(box.face_m(*face))
        if pixel is not None and abs(pixel[0] - x) < _GRIP_PX and abs(pixel[1] - y) < _GRIP_PX:
            return face
    return None


def is_pressed(viewport: Viewport) -> bool:
    """Return True if the left button was pressed over the viewport in this frame."""
    return viewport.hovered and imgui.is_mouse_clicked(imgui.MouseButton_.left)
