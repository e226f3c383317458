"""Glass group of the Rain panel: water on the glass in front of cameras, and the cameras of a rig that have some."""

from imgui_bundle import imgui

from gsrain_engine.editor.document import Document
from gsrain_engine.fields import fields_of
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.scene.scene import Scene
from gsrain_engine.water.pane import GlassKind, is_behind_glass

from ..widgets import fields
from ..widgets.fields import disabled
from ..widgets.text import visible_name

GROUP = "Glass"


def glass_fields(document: Document) -> None:
    """Edit the water on the glass; the wiper only of windshields. The viewport shows it live."""
    kind = document.rain_now.glass
    if kind == "none":
        fields.faint("There is no glass in front of the camera.")
    else:
        if kind == "lens":
            fields.faint("It is upright: only wind from ahead, or its own motion, drives drops against it.")
        for rig in document.scene.rigs:
            imgui.text_wrapped(_sentence(document.scene, rig, kind))
    for each in fields_of(RainSettings):
        if each.group == GROUP and each.name != "glass":
            with disabled(kind == "none" or (each.name == "wiper" and kind == "lens")):
                fields.rain_field(document, each.name)


def _sentence(scene: Scene, rig: str, kind: GlassKind) -> str:
    cameras = scene.rigs[rig]
    behind = [each.name for each in cameras if is_behind_glass(kind, each.camera_to_ego[:3, :3])]
    names = ", ".join(map(visible_name, behind)) if 0 < len(behind) < len(cameras) else ("all" if behind else "none")
    glass = "a windshield" if kind == "windshield" else "the glass of a lens"
    return f"{visible_name(rig)}: {names} of {len(cameras)} cameras behind {glass}."
