"""Select by a box placed in the world."""

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.edits.cropping import CropBox
from gsrain_engine.session.selection.volumes import standing_on
from gsrain_engine.session.session import Session
from gsrain_engine.session.view.picking import pick_point

from ..widgets.markers import draw_hint
from ..widgets.viewport import Viewport
from .box_faces import Face, draw_box, face_under_mouse, is_pressed
from .selecting import MODIFIERS, apply_volume, beside, mode_options, volume_buttons

_FIRST_SIZE_M = (2.0, 2.0, 2.0)


class BoxTool:
    """Click a surface to stand it there, drag its faces, apply."""

    name = "Box"
    icon = icons_fontawesome_6.ICON_FA_CUBE
    key: imgui.Key | None = imgui.Key.x
    help = f"Click on a surface, drag the dots on the faces; Enter selects what is inside. {MODIFIERS}"

    def __init__(self) -> None:
        self._held: Face | None = None

    def draw(self, session: Session, viewport: Viewport) -> bool:
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

    def options(self, session: Session) -> None:
        options = session.selecting
        mode_options(session)
        box = options.box
        if box is None:
            return
        beside(14.5)
        em = imgui.get_font_size()
        _word("at")
        imgui.set_next_item_width(12 * em)
        _, center = imgui.drag_float3("##center", list(box.center_m), 0.02, -1e5, 1e5, "%.2f")
        imgui.set_item_tooltip("Middle of the box in the world: x, y, z in metres.")
        beside(14.5)
        _word("size")
        imgui.set_next_item_width(12 * em)
        flags = imgui.SliderFlags_.always_clamp
        _, size = imgui.drag_float3("##size", list(box.size_m), 0.02, 0.01, 1e5, "%.2f", flags)
        imgui.set_item_tooltip("Size of the box along its own x, y, z in metres.")
        beside(7)
        _word("turn")
        imgui.set_next_item_width(4.5 * em)
        _, yaw = imgui.drag_float("##yaw", box.yaw_deg, 0.5, -180.0, 180.0, "%.1f°", flags)
        imgui.set_item_tooltip("Turn of the box to the left, in degrees.")
        options.box = CropBox((center[0], center[1], center[2]), (size[0], size[1], size[2]), yaw)
        if volume_buttons(session, options.box, "box"):
            options.box = None

    def _place(self, session: Session, viewport: Viewport) -> None:
        """Stand the box on the surface under the mouse, as large as it was before."""
        point = pick_point(session.scene, viewport.shot, *viewport.mouse_px)
        if point is not None:
            before = session.selecting.box or CropBox((0.0, 0.0, 0.0), _FIRST_SIZE_M)
            session.selecting.box = standing_on(before, point)


def _word(text: str) -> None:
    imgui.align_text_to_frame_padding()
    imgui.text_disabled(text)
    imgui.same_line()
