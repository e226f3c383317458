"""Lamps in the Rain panel: which ones light the rain, and the list of the scene's own."""

from pathlib import Path

import numpy as np
from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.choices import FOUND_LAMPS, HEADLIGHTS, NO_LAMPS
from gsrain_engine.editor.document import Document
from gsrain_engine.editor.edits.lamps import LampFields, add_lamp, change_lamp, lamp_at, remove_lamp
from gsrain_engine.editor.edits.members import unique_name
from gsrain_engine.editor.jobs.job import JobRunner
from gsrain_engine.editor.lamps import LampFinder
from gsrain_engine.editor.status import StatusBus
from gsrain_engine.editor.viewport.picking import pick_point
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.scene.lamp_choice import load_lamps
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.scene import Scene

from ..widgets import fields
from ..widgets.fields import CLAMPED, LOGARITHMIC, button, checkbox, plain_label, share_of_width
from ..widgets.file_dialogs import ask_what_to_open
from ..widgets.numbers import slide
from ..widgets.text import visible_name
from ..widgets.type_ahead import combo_box

_TITLES = {
    None: "the scene's own", NO_LAMPS: "none", FOUND_LAMPS: "found in the scene",
    HEADLIGHTS: "headlights of all vehicles",
}  # fmt: skip
_LISTED = 6  # rows of the list before it scrolls
_AHEAD_M = 10.0  # distance of a new lamp where the middle of the view shows no surface
_ABOVE_M = 0.3  # height of a new lamp above the surface there
_BRIGHTEST_M2 = 1e4


def lamp_fields(document: Document, viewport: ViewportState, lamps: LampFinder, jobs: JobRunner) -> None:
    """Edit the lamps of the scene."""
    if document.rain.lamps not in (None, HEADLIGHTS):
        fields.faint("The scene's own lamps are not used.")
    _list(document, viewport, lamps, jobs)


def lamp_choice(document: Document, status: StatusBus) -> None:
    """Choose the lamps that light the rain."""
    own = document.rain.lamps
    names = [*_TITLES, *([own] if own not in _TITLES else [])]
    fields.field_label("lamps")
    imgui.set_next_item_width(-fields.keyframe_button_width())
    titles = [_TITLES.get(each) or Path(each or "").name for each in names]
    changed, at = combo_box("##lamps", names.index(own), titles)
    if changed:
        document.change_rain("Light sources", lamps=names[at])
    imgui.same_line()
    if fields.square_button(icons_fontawesome_6.ICON_FA_FOLDER_OPEN, "choose lamps"):
        kinds = "Lamps{.json,.yaml,.yml}"
        ask_what_to_open("Lamps", kinds, lambda chosen: _use(document, status, chosen[0]))
    imgui.set_item_tooltip("Choose a file of lamps...")


def _use(document: Document, status: StatusBus, path: Path) -> None:
    """Use a file of lamps, if it can be read."""
    try:
        load_lamps(path)
    except (ValueError, OSError) as error:
        status.report(error)
    else:
        document.change_rain("Light sources", lamps=str(path))


# Lamps of the scene


def _list(document: Document, viewport: ViewportState, finder: LampFinder, jobs: JobRunner) -> None:
    lamps, options = document.scene.lamps, viewport.options
    options.show_lamps = checkbox("Show lamps", options.show_lamps, "Mark the scene's lamps in the viewport.")
    options.lamp = min(options.lamp, len(lamps) - 1)
    if lamps:
        rows = min(len(lamps), _LISTED)
        height = rows * imgui.get_text_line_height_with_spacing() + 2 * imgui.get_style().frame_padding.y
        if imgui.begin_list_box("##lamps of the scene", ImVec2(-1, height)):
            for number, lamp in enumerate(lamps):
                mount = "" if lamp.mount == "scene" else f"  ({visible_name(lamp.mount)})"
                title = f"{visible_name(lamp.name) or 'lamp'}{mount}###lamp {number}"
                if imgui.selectable(title, number == options.lamp)[0]:
                    options.lamp = number
            imgui.end_list_box()
    width = share_of_width(2)
    if button("Add lamp", "Add a lamp at the surface in the middle of the view.", width=width):
        _add(document, viewport)
    imgui.same_line()
    help_text = "Remove the chosen lamp from the scene; undo restores it."
    if button("Remove lamp", help_text, width=width, enabled=options.lamp >= 0) and options.lamp >= 0:
        document.edit(f"Remove {_name(lamps[options.lamp])}", remove_lamp, options.lamp)
        return
    job = jobs.newest("lamps")
    help_text = "Add lamps that are bright spots of a scene captured by night; their light is measured around them."
    if button("Find lamps", help_text, width=-1, enabled=bool(document.scene.members) and not jobs.is_running("lamps")):
        finder.find()
    if job is not None:
        fields.faint(job.error or job.progress.message)
    if options.lamp >= 0:
        _edit(document, options.lamp)


def _add(document: Document, viewport: ViewportState) -> None:
    point, scene = _middle_of_view(document.scene, viewport), document.scene
    name = unique_name("lamp", {lamp.name for lamp in scene.lamps})
    if document.edit(f"Add {name}", add_lamp, lamp_at(scene, point, name)):
        viewport.options.lamp, viewport.options.show_lamps = len(document.scene.lamps) - 1, True


def _middle_of_view(scene: Scene, viewport: ViewportState) -> np.ndarray:
    """World point (m) just above the surface in the middle of the view; 10 m ahead if there is none."""
    shot = viewport.shot(960, 640)
    found = pick_point(scene, shot, 480.0, 320.0)
    if found is None:
        return shot.camera.position + _AHEAD_M * shot.camera.world_to_camera[2, :3]
    return found + np.array([0.0, 0.0, _ABOVE_M])


def _name(lamp: Lamp) -> str:
    return lamp.name or "lamp"


def _edit(document: Document, number: int) -> None:
    """Edit the fields of a lamp; one drag is one undo step."""
    lamp = document.scene.lamps[number]

    def change(field: str, changes: LampFields) -> None:
        document.edit(f"{_name(lamp)}: {field}", change_lamp, number, gesture=f"lamp {number} {field}", **changes)

    frame = "the scene's units and axes" if lamp.mount == "scene" else "the frame of its vehicle: x forward, y left"
    plain_label("Position", f"In {frame}.")
    changed, position = imgui.drag_float3("##position", list(lamp.position), 0.02, 0.0, 0.0, "%.2f")
    if changed:
        x, y, z = position
        change("position", {"position": (x, y, z)})
    fields.end_gesture_when_released(document)
    plain_label("Direction", f"Axis of its cone, in {frame}.")
    changed, direction = imgui.drag_float3("##direction", list(lamp.direction), 0.02, -1.0, 1.0, "%.2f", CLAMPED)
    if changed and np.linalg.norm(direction) > 1e-3:
        x, y, z = direction
        change("direction", {"direction": (x, y, z)})
    fields.end_gesture_when_released(document)
    plain_label("Color", "Linear light; a factor on the intensity.")
    flags = imgui.ColorEditFlags_.no_inputs | imgui.ColorEditFlags_.float | imgui.ColorEditFlags_.hdr
    changed, color = imgui.color_edit3("##lamp color", list(lamp.color), flags)
    if changed:
        red, green, blue = (max(channel, 0.0) for channel in color[:3])
        change("color", {"color": (red, green, blue)})
    fields.end_gesture_when_released(document)
    plain_label("Intensity (m\u00b2)", "Irradiance times squared distance; pi on a white wall is display white.")
    changed, intensity = slide("##intensity_m2", lamp.intensity_m2, 0.0, _BRIGHTEST_M2, "%.4g", LOGARITHMIC)
    if changed:
        change("intensity", {"intensity_m2": intensity})
    fields.end_gesture_when_released(document)
    for name, title, text in (
        ("inner_deg", "Full within", "Angle from the axis up to which the intensity is full; 180 has no cone."),
        ("outer_deg", "Dark beyond", "Angle from the axis beyond which there is no light."),
    ):
        plain_label(title, text)
        changed, angle = slide(f"##{name}", getattr(lamp, name), 0.0, 180.0, "%.0f\u00b0", unit="\u00b0")
        if changed:
            change(title.lower(), {name: angle})  # pyright: ignore[reportArgumentType]
        fields.end_gesture_when_released(document)
