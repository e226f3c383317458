"""The tool "Crop": a box whose faces are dragged; what lies outside of it is deleted."""

from dataclasses import dataclass, replace

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.edits.cropping import CropBox, box_around, crop
from gsrain_engine.session.session import Session

from ..picture.viewport import Viewport
from ..widgets.markers import YELLOW, draw_hint, draw_line, draw_point

_EDGES = [(corner, corner | bit) for corner in range(8) for bit in (1, 2, 4) if not corner & bit]
_FACES = [(axis, upper) for axis in range(3) for upper in (False, True)]
_GRIP_PX = 12.0
_BRIGHT = (1.0, 1.0, 1.0, 1.0)


@dataclass(slots=True)
class CropTool:
    """A `Tool`."""

    name: str = "Crop"
    icon: str = icons_fontawesome_6.ICON_FA_CROP_SIMPLE
    key: imgui.Key | None = None
    help: str = "Drag the faces of the box by their dots, then Apply: what lies outside of it is deleted."
    box: CropBox | None = None
    _scene_name: str = ""
    _held: tuple[int, bool] | None = None

    def draw(self, session: Session, viewport: Viewport) -> bool:
        """Draw the box and let its faces be dragged."""
        box = self._box_of(session.scene)
        corners = box.corners_m
        for first, second in _EDGES:
            draw_line(viewport, corners[first], corners[second])
        under = self._face_under_mouse(viewport, box) if viewport.hovered else None
        if under is not None and imgui.is_mouse_clicked(imgui.MouseButton_.left):
            self._held = under
        if not imgui.is_mouse_down(imgui.MouseButton_.left):
            self._held = None
        if self._held is not None and viewport.active:
            self.box = box.pulled(*self._held, *viewport.ray(*viewport.mouse_px))
        for face in _FACES:
            is_bright = face in (under, self._held)
            draw_point(viewport, box.face_m(*face), _BRIGHT if is_bright else YELLOW, 7 if is_bright else 6)
        draw_hint(viewport, "Drag the dots on the faces, then Apply")
        return self._held is not None or under is not None

    def options(self, session: Session) -> None:
        """Edit the box by numbers; apply it."""
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

    def _face_under_mouse(self, viewport: Viewport, box: CropBox) -> tuple[int, bool] | None:
        x, y = viewport.mouse_px
        for face in _FACES:
            pixel = viewport.pixel(box.face_m(*face))
            if pixel is not None and abs(pixel[0] - x) < _GRIP_PX and abs(pixel[1] - y) < _GRIP_PX:
                return face
        return None


_CLAMP = imgui.SliderFlags_.always_clamp
