"""Selection by a box or sphere in the world, and the tool "Crop"."""

from dataclasses import replace

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.edits.gaussians import CropBox, box_around, crop
from gsrain_engine.editor.selection.commands import SelectionTool
from gsrain_engine.editor.selection.volume import Sphere, Volume, in_volume, placed_on
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.scene.scene import Scene

from ..widgets.draw import WHITE, YELLOW, Canvas, draw_hint, draw_line, draw_point
from ..widgets.fields import button, same_line_if_room
from ..widgets.text import inline_text
from .base import CLAMP, DragTool, Tool, drag_number, drag_vector, draw_polyline, point_under_mouse
from .select_screen import MODIFIERS, mode_now, mode_options

_FIRST_SHARE = 0.2  # of the viewport's height: first side of a box, and diameter of a sphere
_SPEED = 0.01  # of the size: a pixel of a drag over a number
_CENTER_HELP = "Middle of the box in the world: x, y, z in meters."
_SIZE_HELP = "Size of the box along its own x, y, z in meters."
_YAW_HELP = "Turn of the box to the left, in degrees."


class BoxFaceTool(Tool):
    """A tool with a box that has a dot on each face."""

    _held: tuple[int, bool] | None = None

    def drag_faces(self, canvas: Canvas, box: CropBox) -> CropBox:
        """Move the face whose dot is dragged; returns the box."""
        if is_pressed(canvas):
            self._held = face_under_mouse(canvas, box)
        if not (canvas.active and imgui.is_mouse_down(imgui.MouseButton_.left)):
            self._held = None
        return box if self._held is None else box.pulled(*self._held, *canvas.ray(*canvas.mouse_px))

    def draw_box(self, canvas: Canvas, box: CropBox) -> None:
        """Draw the edges and the dots; the dragged one, or the one under the mouse, is bright."""
        for first, second in _EDGES:
            draw_line(canvas, box.corners_m[first], box.corners_m[second])
        bright = (self._held, face_under_mouse(canvas, box))
        for face in _FACES:
            draw_point(canvas, box.face_m(*face), *((WHITE, 7) if face in bright else (YELLOW, 6)))


class BoxTool(BoxFaceTool):
    """Click a surface to place the box, drag its faces, apply."""

    name = "Box"
    icon = icons_fontawesome_6.ICON_FA_CUBE
    key = imgui.Key.x
    help = f"Click on a surface, drag the dots on the faces; Enter selects what is inside. {MODIFIERS}"

    def __init__(self, document: Document, playback: Playback, selection: SelectionTool) -> None:
        self._document, self._playback, self._selection = document, playback, selection

    def draw(self, canvas: Canvas) -> bool:
        options = self._selection
        if options.box is not None:
            options.box = self.drag_faces(canvas, options.box)
        if is_pressed(canvas) and self._held is None:  # in its previous size
            point = point_under_mouse(self._document, canvas)
            if point is not None:
                side = canvas.size_m(_FIRST_SHARE, point)
                options.box = placed_on(options.box or CropBox((0.0, 0.0, 0.0), (side, side, side)), point)
        if options.box is None:
            draw_hint(canvas, "Click on a surface to put the box there")
            return True
        self.draw_box(canvas, options.box)
        draw_hint(canvas, "Drag the dots; Enter selects what is inside; click elsewhere to place it anew")
        _apply_on_enter(self._selection, canvas, options.box, "box")
        return True

    def options(self) -> None:
        mode_options(self._selection)
        box = self._selection.box
        if box is None:
            return
        speed = _SPEED * max(box.size_m)
        same_line_if_room(14.5)
        inline_text("at", faint=True)
        _, center = drag_vector("##center", box.center_m, speed, -1e5, _CENTER_HELP, 12, flags=0)
        same_line_if_room(14.5)
        inline_text("size", faint=True)
        _, size = drag_vector("##size", box.size_m, speed, 0.01, _SIZE_HELP, 12)
        same_line_if_room(7)
        inline_text("turn", faint=True)
        _, yaw = drag_number("##yaw", box.yaw_deg, 0.5, (-180.0, 180.0), "%.1f°", _YAW_HELP, 4.5)
        self._selection.box = CropBox(center, size, yaw)
        if _is_dropped(self._playback, self._selection, self._selection.box, "box"):
            self._selection.box = None


class SphereTool(DragTool):
    """Click a surface for the center, drag for the radius, apply."""

    name = "Sphere"
    icon = icons_fontawesome_6.ICON_FA_GLOBE
    key = imgui.Key.o
    help = f"Press on a surface for the center, drag for the radius; Enter selects what is inside. {MODIFIERS}"

    def __init__(self, document: Document, playback: Playback, selection: SelectionTool) -> None:
        self._document, self._playback, self._selection = document, playback, selection

    def draw(self, canvas: Canvas) -> bool:
        options = self._selection
        if is_pressed(canvas):
            point = point_under_mouse(self._document, canvas)
            if point is not None:
                x, y, z = point.tolist()
                before = options.ball
                radius_m = canvas.size_m(_FIRST_SHARE / 2, point) if before is None else before.radius_m
                options.ball = Sphere((x, y, z), radius_m)
        if self.follow_drag(canvas) == "dragged" and self.has_moved and options.ball is not None:
            options.ball = options.ball.reaching(*canvas.ray(*canvas.mouse_px))
        if options.ball is None:
            draw_hint(canvas, "Press on a surface for the center, drag for the radius")
            return True
        for circle in options.ball.circles_m(points=64):
            pixels = [pixel for point in circle if (pixel := canvas.pixel(point)) is not None]
            if len(pixels) == len(circle):
                draw_polyline(canvas, pixels, closed=True)
        draw_point(canvas, options.ball.middle, radius=4)
        draw_hint(canvas, "Enter selects what is inside; press elsewhere to place it anew")
        _apply_on_enter(self._selection, canvas, options.ball, "sphere")
        return True

    def options(self) -> None:
        mode_options(self._selection)
        ball = self._selection.ball
        if ball is None:
            return
        same_line_if_room(13)
        help_text = "Center of the sphere in the world: x, y, z in meters."
        moved, center = drag_vector("##center", ball.center_m, _SPEED * ball.radius_m, -1e5, help_text, 13, flags=0)
        same_line_if_room(7)
        help_text, flags = "Radius of the sphere in meters.", CLAMP | imgui.SliderFlags_.logarithmic
        sized, radius = drag_number(
            "##radius_m", ball.radius_m, 0.01, (0.01, 1e4), "radius %.2f m", help_text, 7, flags
        )
        if moved or sized:
            self._selection.ball = ball = Sphere(center, radius)
        if _is_dropped(self._playback, self._selection, ball, "sphere"):
            self._selection.ball = None


def _apply_on_enter(selection: SelectionTool, canvas: Canvas, volume: Volume, name: str) -> None:
    keys = (imgui.Key.enter, imgui.Key.keypad_enter)
    if not imgui.get_io().want_text_input and any(imgui.is_key_pressed(key, False) for key in keys):
        _apply(selection, canvas.shot.time_s, volume, name)


def _apply(selection: SelectionTool, time_s: float, volume: Volume, name: str) -> None:
    selection.select(mode_now(selection), name, in_volume, time_s, volume)


def _is_dropped(playback: Playback, selection: SelectionTool, volume: Volume, name: str) -> bool:
    """Draw the buttons of a volume; returns True if it is to be removed."""
    same_line_if_room(11)
    if button(f"Apply##{name}", "Select what is inside (Enter), whether the camera sees it or not."):
        _apply(selection, playback.clock.time_s, volume, name)
    imgui.same_line()
    return button(f"Drop##{name}", f"Take the {name} away; the selection stays.")


class CropTool(BoxFaceTool):
    """Tool that deletes everything outside a box."""

    name = "Crop"
    icon = icons_fontawesome_6.ICON_FA_CROP_SIMPLE
    help = "Drag the faces of the box by their dots, then Apply: what lies outside of it is deleted."
    box: CropBox | None = None
    _scene_name = ""

    def __init__(self, document: Document) -> None:
        self._document = document

    def draw(self, canvas: Canvas) -> bool:
        self.box = self.drag_faces(canvas, self._box_of(self._document.scene))
        self.draw_box(canvas, self.box)
        draw_hint(canvas, "Drag the dots on the faces, then Apply")
        return self._held is not None or face_under_mouse(canvas, self.box) is not None

    def options(self) -> None:
        box = self._box_of(self._document.scene)
        help_text = "Delete what lies outside, of background layers that are shown and not locked."
        if button("Apply##crop", help_text):
            self._document.edit("Crop to the box", crop, box)
        imgui.same_line()
        if button("Reset##crop", "Put the box around most of what can be seen."):
            box = box_around(self._document.scene)
        imgui.same_line()
        changed, yaw = drag_number("##yaw", box.yaw_deg, 0.5, (-180, 180), "%.1f°", _YAW_HELP, 5, flags=0)
        if changed:
            box = replace(box, yaw_deg=yaw)
        for name, words, low, help_text in (
            ("center_m", "middle", -1e5, _CENTER_HELP),
            ("size_m", "size", 0.01, _SIZE_HELP),
        ):
            imgui.align_text_to_frame_padding()
            imgui.text(words)
            imgui.same_line(4.2 * imgui.get_font_size())
            changed, value = drag_vector(f"##{name}", getattr(box, name), _SPEED * max(box.size_m), low, help_text, 15)
            if changed:
                box = replace(box, **{name: value})
        self.box = box

    def _box_of(self, scene: Scene) -> CropBox:
        if self.box is None or self._scene_name != scene.name:
            self.box, self._scene_name = box_around(scene), scene.name
        return self.box


_EDGES = [(corner, corner | bit) for corner in range(8) for bit in (1, 2, 4) if not corner & bit]
_FACES = [(axis, upper) for axis in range(3) for upper in (False, True)]
_GRIP_PX = 10.0


def face_under_mouse(canvas: Canvas, box: CropBox) -> tuple[int, bool] | None:
    """Return the face of the dot under the mouse: its axis, and True for its upper side."""
    for face in _FACES if canvas.hovered else ():
        pixel = canvas.pixel(box.face_m(*face))
        if pixel is not None and canvas.is_mouse_near(pixel, _GRIP_PX):
            return face
    return None


def is_pressed(canvas: Canvas) -> bool:
    """Return True if the left button was pressed over the viewport in this frame."""
    return canvas.hovered and imgui.is_mouse_clicked(imgui.MouseButton_.left)
