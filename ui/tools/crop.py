"""The tool "Crop": a box whose faces are dragged; what lies outside of it is deleted."""

from dataclasses import dataclass, replace

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.edits.cropping import CropBox, box_around, crop
from gsrain_engine.session.session import Session

from ..widgets.markers import draw_hint
from ..widgets.viewport import Viewport
from .box_faces import Face, draw_box, face_under_mouse, is_pressed


@dataclass(slots=True)
class CropTool:
    """A `Tool`."""

    name: str = "Crop"
    icon: str = icons_fontawesome_6.ICON_FA_CROP_SIMPLE
    key: imgui.Key | None = None
    help: str = "Drag the faces of the box by their dots, then Apply: what lies outside of it is deleted."
    box: CropBox | None = None
    _scene_name: str = ""
    _held: Face | None = None

    def draw(self, session: Session, viewport: Viewport) -> bool:
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

    def options(self, session: Session) -> None:
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
