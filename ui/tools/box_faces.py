"""A box of the world drawn over the picture, with a dot on each face to drag it by."""

from imgui_bundle import imgui

from gsrain_engine.session.edits.cropping import CropBox

from ..widgets.markers import YELLOW, draw_line, draw_point
from ..widgets.viewport import Viewport

Face = tuple[int, bool]
"""Axis, and whether it is its upper side."""

_EDGES = [(corner, corner | bit) for corner in range(8) for bit in (1, 2, 4) if not corner & bit]
_FACES: list[Face] = [(axis, upper) for axis in range(3) for upper in (False, True)]
_GRIP_PX = 10.0
_BRIGHT = (1.0, 1.0, 1.0, 1.0)


def draw_box(viewport: Viewport, box: CropBox, held: Face | None) -> None:
    """Draw the edges and the dots; the one that is held, or under the mouse, is bright."""
    for first, second in _EDGES:
        draw_line(viewport, box.corners_m[first], box.corners_m[second])
    under = face_under_mouse(viewport, box)
    for face in _FACES:
        is_bright = face in (held, under)
        draw_point(viewport, box.face_m(*face), _BRIGHT if is_bright else YELLOW, 7 if is_bright else 6)


def face_under_mouse(viewport: Viewport, box: CropBox) -> Face | None:
    """Whose dot the mouse is over."""
    x, y = viewport.mouse_px
    for face in _FACES if viewport.hovered else ():
        pixel = viewport.pixel(box.face_m(*face))
        if pixel is not None and abs(pixel[0] - x) < _GRIP_PX and abs(pixel[1] - y) < _GRIP_PX:
            return face
    return None


def is_pressed(viewport: Viewport) -> bool:
    """Whether the left button went down over the picture just now."""
    return viewport.hovered and imgui.is_mouse_clicked(imgui.MouseButton_.left)
