"""Table of all commands, in the order of the menus. A new command is a row."""

from collections.abc import Callable
from operator import attrgetter
from pathlib import Path
from typing import get_args

from gsrain_engine.editor.camera_path import CameraPathEditor
from gsrain_engine.editor.capture_view import CaptureController
from gsrain_engine.editor.document import Document
from gsrain_engine.editor.drive import RolloutPlayer
from gsrain_engine.editor.edits import gaussians, layers
from gsrain_engine.editor.edits.actors import drive_along_own_path
from gsrain_engine.editor.edits.level import level_from_ground
from gsrain_engine.editor.files import Files
from gsrain_engine.editor.jobs.make_rainy import MAKE_RAINY_TITLE
from gsrain_engine.editor.recorder import RenderQueue
from gsrain_engine.editor.selection.commands import SelectionTool
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.editor.viewport.camera_follow import ChaseMode
from gsrain_engine.editor.viewport.options import Split
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.rain.keyframes import Keyed
from gsrain_engine.render.renderer import RenderMode
from gsrain_engine.scene.formats.registry import scene_suffixes
from gsrain_engine.scene.scene import Scene

from ..panels import capture, drive, timeline
from ..panels.rain import PICK_TOOL
from ..panels.rain_keyframes import PASSING_SHOWER_HELP, add_passing_shower, ask_for_rate_file, clear_keyframes
from ..panels.record import ask_where_to_record, ask_where_to_render_image
from ..widgets.fields import SCENE_FOLDERS, ask_what_to_open, ask_where_to_save, exported_kinds, toggle_keyframe
from .base import Command

_Run = Callable[..., object]
_Test = Callable[..., bool]

# Preconditions and states


def _has_scene(document: Document) -> bool:
    return bool(document.scene.members)


def _has_selection(document: Document) -> bool:
    return bool(gaussians.selected_count(document.scene))


def _has_editable_selection(selection: SelectionTool) -> bool:
    return not selection.is_empty


def _has_member(document: Document, viewport: ViewportState) -> bool:
    return any(each.key == viewport.options.member for each in document.scene.members)


def _has_actor(document: Document, viewport: ViewportState) -> bool:
    return any(each.key == viewport.options.member for each in document.scene.actors)


def _has_path(document: Document) -> bool:
    return document.scene.path is not None


def _has_keyframe(camera_path: CameraPathEditor) -> bool:
    return camera_path.active_key is not None


def _has_capture(captures: CaptureController) -> bool:
    return captures.capture is not None


def _plays(rollouts: RolloutPlayer) -> bool:
    return rollouts.playing is not None


def _can_record(document: Document, render_queue: RenderQueue) -> bool:
    return _has_scene(document) and not render_queue.is_recording


def _is(field: str, value: object = True) -> _Test:
    """Compare a field of a part, such as "viewport.options.tool"."""
    return lambda editor: attrgetter(field)(editor) == value


def _shows_regions(viewport: ViewportState) -> bool:
    return viewport.options.show_streak_region and viewport.options.show_haze_region


# Functions of commands


def _call(method: str) -> _Run:
    """Call a method of a part, such as "document.undo"."""
    return lambda editor: attrgetter(method)(editor)()


def _set(field: str, value: object) -> _Run:
    owner, _, name = field.rpartition(".")
    return lambda editor: setattr(attrgetter(owner)(editor), name, value)


def _toggle(field: str) -> _Run:
    owner, _, name = field.rpartition(".")
    return lambda editor: setattr(attrgetter(owner)(editor), name, not attrgetter(field)(editor))


def _toggle_rain(field: str, title: str) -> _Run:
    def run(document: Document) -> None:
        is_on = not getattr(document.rain, field)
        document.change_rain(f"{title} {'on' if is_on else 'off'}", **{field: is_on})

    return run


def _toggle_tool(tool: str) -> _Run:
    return lambda viewport: setattr(viewport.options, "tool", "" if viewport.options.tool == tool else tool)


def _toggle_regions(viewport: ViewportState) -> None:
    viewport.options.show_streak_region = viewport.options.show_haze_region = not _shows_regions(viewport)


def _edit(label: str, change: Callable[[Scene], Scene]) -> _Run:
    return lambda document: document.edit(label, change)


def _opened(path: Path) -> str:
    return str(path.parent if path.name == "scene.json" else path)


def _scene_kinds() -> str:
    """Return the file types of a dialog: extensions of all scene files, including those of installed packages."""
    ends = dict.fromkeys(Path(f"scene{suffix}").suffix for suffix in scene_suffixes())
    return f"Scenes{{{','.join(ends)}}},All files{{.*}}"


def _ask_what_to_open(files: Files) -> None:
    ask_what_to_open("Open a scene", _scene_kinds(), lambda chosen: files.open(_opened(chosen[0])))


def _ask_what_to_import(files: Files) -> None:
    def take(chosen: list[Path]) -> None:
        for path in chosen:
            files.import_from(_opened(path))

    ask_what_to_open("Import into this scene", _scene_kinds(), take, several=True)


def _ask_where_to_save(files: Files) -> None:
    ask_where_to_save("Save the scene", SCENE_FOLDERS, lambda chosen: files.save_as(chosen[0]))


def _ask_where_to_export(files: Files) -> None:
    ask_where_to_save("Export a file", exported_kinds(), lambda chosen: files.export_to(chosen[0]))


def _delete(document: Document, playback: Playback) -> None:
    if not playback.timeline.takes_keys or playback.timeline.key is None:  # else Delete is for the active keyframe
        document.edit("Delete the selection", gaussians.delete_selected)


def _duplicate(document: Document, viewport: ViewportState) -> None:
    before, key = {each.key for each in document.scene.members}, viewport.options.member
    document.edit(f"Duplicate {document.scene.member(key).name}", layers.duplicate, key)
    viewport.options.member = next((each.key for each in document.scene.members if each.key not in before), key)


def _follow_actor(viewport: ViewportState) -> None:
    viewport.follow_actor(viewport.options.member)


def _keyframe(change: Callable[[CameraPathEditor, int], None]) -> _Run:
    """Change the active keyframe."""

    def run(camera_path: CameraPathEditor) -> None:
        if (key := camera_path.active_key) is not None:
            change(camera_path, key)

    return run


def _loop_path(document: Document, camera_path: CameraPathEditor) -> None:
    if (path := document.scene.path) is not None:
        camera_path.change_path("Loop off" if path.loop else "Loop on", loop=not path.loop)


def _jump_to_collision(rollouts: RolloutPlayer) -> None:
    if (playing := rollouts.playing) is not None and playing.collision_s is not None:
        rollouts.jump(playing.collision_s)


def _jump_to_smallest_ttc(rollouts: RolloutPlayer) -> None:
    if (playing := rollouts.playing) is not None:
        rollouts.jump(playing.curves.min_ttc_time_s)


# Rows made from tables


def _intensity(name: str, rate: float) -> Command:
    return Command(
        f"{name} {rate:g} mm/h" if rate else name,
        lambda document: document.change_rain(f"Intensity {rate:g} mm/h", intensity_mm_h=rate),
        "Rain",
        help="If the intensity has keyframes, set one at the present time.",
        is_on=lambda document: document.rain_now.intensity_mm_h == rate,
    )


def _rain_keyframe(title: str, field: Keyed) -> Command:
    help_text = f"Insert a keyframe of the present {title} at the present time, or remove the one that is there."
    return Command(
        f"Insert {title} keyframe",
        lambda document, viewport, playback: toggle_keyframe(document, viewport, playback, field),
        "Rain",
        help=help_text,
    )


def _follow_ego(name: str, mode: ChaseMode, help_text: str) -> Command:
    return Command(
        name, lambda rollouts: rollouts.follow(mode), "Drive", "", help_text, _plays,
        lambda rollouts, viewport: _plays(rollouts) and viewport.chase.mode == mode,
    )  # fmt: skip


_COMPARE_HELP = "Compare two images; drag the line between them."

ACTION_GROUPS: tuple[tuple[Command, ...], ...] = (
    # Files
    (
        Command("Open...", _ask_what_to_open, "File", "Ctrl+O",
                "Open a scene file, or a scene folder by its scene.json."),
        Command("Open the built-in street", lambda files: files.open("street"), "File",
                help="A street with cars and trees that needs no download."),
    ),
    (
        Command("Import into this scene...", _ask_what_to_import, "File", "Ctrl+Shift+O",
                "Add the layers and actors of other scenes at their positions in the world (meters)."),
        Command("Import the built-in street", lambda files: files.import_from("street"), "File",
                help="Add the street's layers and its car to this scene.", is_possible=_has_scene),
    ),
    (
        Command("Save", _call("files.save"), "File", "Ctrl+S",
                "Save to the scene folder that was opened or saved last; asks for one if there is none.", _has_scene),
        Command("Save as...", _ask_where_to_save, "File", "Ctrl+Shift+S",
                "Save to another scene folder, which holds everything.", _has_scene),
        Command("Export...", _ask_where_to_export, "File", "Ctrl+E",
                "Write visible Gaussians to one file (.ply, .splat, .spz); the document stays unsaved.",
                _has_scene),
        Command("Revert", _call("files.revert"), "File",
                help="Reload the scene from disk; all changes since it was saved are lost.",
                is_possible=lambda files: files.source is not None),
        Command("Close the scene", _call("files.close_scene"), "File", "Ctrl+W",
                "Close the scene; the window stays open.", _has_scene),
    ),
    (
        Command("Open a capture...", capture.ask_for_capture_folder, "File", help=capture.OPEN_FOLDER_HELP),
        Command("Open a capture file...", capture.ask_for_capture_file, "File", help=capture.OPEN_FILE_HELP),
        Command("Close the capture", _call("captures.close_capture"), "File",
                help="Close the capture; the scene stays open.", is_possible=_has_capture),
    ),
    (
        Command("Record the timeline...", ask_where_to_record, "File", "Ctrl+R",
                "Render the camera path, or rig cameras, to a video or frames in the background; see the Record panel.",
                _can_record),
        Command("Render image...", ask_where_to_render_image, "File", "Ctrl+Shift+R",
                "Render the present view at the present time, in the size and with the samples of the Record panel.",
                _can_record),
    ),
    # Editing
    (
        Command("Undo", _call("document.undo"), "Edit", "Ctrl+Z", "Revert the last step.",
                lambda document: document.history.undo_label is not None,
                more=lambda document: document.history.undo_label or ""),
        Command("Redo", _call("document.redo"), "Edit", "Ctrl+Shift+Z or Ctrl+Y", "Restore the step that was undone.",
                lambda document: document.history.redo_label is not None,
                more=lambda document: document.history.redo_label or ""),
    ),
    (
        Command("Delete the selection", _delete, "Edit", "Delete",
                "Delete the selected Gaussians; undo restores them.", _has_selection),
        Command("Hide the selection", _edit("Hide the selection", gaussians.hide_selected), "Edit", "H",
                "Do not draw the selected Gaussians.", _has_selection),
        Command("Isolate the selection", _edit("Isolate the selection", gaussians.isolate_selected), "Edit", "Shift+I",
                "Hide everything but the selected Gaussians; locked layers are not changed.", _has_selection),
        Command("Show all", _edit("Show all", gaussians.show_all), "Edit", "Shift+H", "Draw all hidden Gaussians.",
                lambda document: any(each.marks.hidden for each in document.scene.members)),
        Command("Duplicate", _duplicate, "Edit", "Ctrl+D", "Copy the active layer or actor.", _has_member,
                more=lambda viewport: viewport.options.member.partition("/")[2]),
        Command("Separate the selection", _edit("Separate the selection", layers.separate), "Edit", "Ctrl+J",
                "Move the selected Gaussians to a new layer.", _has_selection),
        Command("Purge deleted", _edit("Purge deleted", gaussians.compact), "Edit",
                help="Remove deleted Gaussians from the arrays; undo restores them.",
                is_possible=lambda document: gaussians.deleted_count(document.scene) > 0),
        Command("Level by the ground", _edit("Level by the ground", level_from_ground), "Edit",
                help="Find the largest low plane of the scene and make it level.",
                is_possible=lambda document: bool(document.scene.layers)),
        Command("Follow the actor with the camera", _follow_actor, "Edit",
                help="The camera moves and turns with the active actor.",
                is_possible=_has_actor,
                is_on=lambda viewport: bool(viewport.following.key)),
    ),
    # Selection
    (
        Command("Select all", _call("selection.select_all"), "Select", "Ctrl+A",
                "Select every visible Gaussian of layers and actors that are not locked."),
        Command("Select none", _call("selection.select_none"), "Select", "Ctrl+Shift+A", "Clear the selection.",
                _has_editable_selection),
        Command("Invert the selection", _call("selection.invert"), "Select", "Ctrl+I",
                "Select all visible Gaussians that were not selected."),
        Command("Grow the selection", _call("selection.grow"), "Select",
                "Ctrl+]", "Add Gaussians near the selection, within the distance of the Select panel (meters).",
                _has_editable_selection),
        Command("Shrink the selection", _call("selection.shrink"),
                "Select", "Ctrl+[",
                "Deselect Gaussians near unselected ones, within the distance of the Select panel (meters).",
                _has_editable_selection),
        Command("Save the selection as a set", _call("selection.save_set"), "Select",
                help="Store the selection under a name; the Select panel lists the sets.",
                is_possible=_has_editable_selection),
    ),
    # Rain
    tuple(
        _intensity(name, rate)
        for name, rate in (("No rain", 0.0), ("Light", 1.2), ("Moderate", 5.0), ("Paper", 8.5), ("Heavy", 12.0))
    ),
    (
        Command("Draw streaks", _toggle_rain("streaks", "Streaks"), "Rain", "", "Draw near drops as streaks.",
                is_on=_is("document.rain.streaks")),
        Command("Draw haze", _toggle_rain("haze", "Haze"), "Rain", "", "Draw far drops as haze.",
                is_on=_is("document.rain.haze")),
        Command("Shelter under roofs", _toggle_rain("roofs", "Shelter under roofs"), "Rain", "",
                "No rain under bridges, canopies and trees; they are searched for once.",
                is_on=_is("document.rain.roofs")),
        Command("Show rain regions", _toggle_regions, "Rain", "", "Draw the edges of the regions in the viewport.",
                is_on=_shows_regions),
        Command("Edit rain regions", _toggle_tool("Rain regions"), "Rain", "",
                "Drag the faces of the regions of drops and haze.", is_on=_is("viewport.options.tool", "Rain regions")),
        Command("Pick the drop color", _toggle_tool(PICK_TOOL), "Rain", "",
                "Click a pixel of the viewport or drag a rectangle: its color becomes the drop color.",
                is_on=_is("viewport.options.tool", PICK_TOOL)),
        Command("Reset the drop color to the sky",
                lambda document: document.change_rain("Drop color from the sky", drop_color=None), "Rain", "",
                "Use the mean color of the scene's sky in linear light (eq. 3).",
                lambda document: document.rain.drop_color is not None),
    ),
    (
        _rain_keyframe("intensity", "intensity_mm_h"),
        _rain_keyframe("wind", "wind_m_s"),
        _rain_keyframe("exposure", "exposure_s"),
        Command("Add passing shower", add_passing_shower, "Rain", help=PASSING_SHOWER_HELP),
        Command("Import disdrometer series...", ask_for_rate_file, "Rain",
                help="Make intensity keyframes from measured rain rates.",
                is_possible=lambda calibration: calibration.busy is None),
        Command("Clear rain keyframes", clear_keyframes,
                "Rain", help="Remove all rain keyframes; the values of the Rain panel apply at all times.",
                is_possible=lambda document: bool(document.keyframes.keys)),
    ),
    # Drives and roll-outs
    (
        Command("Drive", _call("rollouts.start"), "Drive",
                help="Drive the scenario of the Drive panel through this scene, in the background.",
                is_possible=lambda rollouts: rollouts.why_not is None),
        Command("Drive ego along the path", _edit("Ego drive", drive_along_own_path), "Drive", "",
                "For scenes without a recorded drive: the ego vehicle follows the camera path, with a front camera.",
                _has_path),
        Command("Open a scenario...", drive.ask_for_scenario, "Drive", help=drive.SCENARIO_HELP),
        Command("Save the scenario...", lambda rollouts: drive.ask_where_to_save_scenario(rollouts.setup),
                "Drive", help="Write the scenario with the changes of the Drive panel as YAML."),
    ),
    (
        Command("Open a roll-out...", drive.ask_for_rollout, "Drive",
                help="Open a finished drive (JSON lines) and play it in the viewport."),
        Command("Save the roll-out...", drive.ask_where_to_save_rollout, "Drive", "", drive.SAVE_ROLLOUT_HELP, _plays),
        Command("Render video of the drive...", drive.ask_where_to_render_drive, "Drive", "", drive.VIDEO_HELP,
                lambda rollouts: rollouts.why_no_video is None),
        Command("Jump to the collision", _jump_to_collision, "Drive", "", "Stop at the time of the collision.",
                lambda rollouts: rollouts.playing is not None and rollouts.playing.collision_s is not None),
        Command("Jump to the smallest TTC", _jump_to_smallest_ttc, "Drive", "",
                "Stop at the time of the smallest time to collision.", _plays),
        _follow_ego("Follow the ego vehicle", "behind", "Look from 8 m behind and 3 m above."),
        _follow_ego("Look through the front camera", "front camera", "Look through the front camera of the ego rig."),
        _follow_ego("Leave the ego vehicle", "free", "The camera stays at its position."),
        Command("Close the roll-outs", _call("rollouts.close_all"), "Drive", "",
                "Show the scene with its own traffic.", _plays),
    ),
    # Time and the camera path
    (
        Command("Go to the start of time", lambda playback: playback.clock.seek(playback.span_s[0]), "Timeline",
                "Ctrl+Left", "Go to the start of the playback range."),
        Command("Go to the end of time", lambda playback: playback.clock.seek(playback.span_s[1]), "Timeline",
                "Ctrl+Right", "Go to the end of the playback range."),
        Command("Go to time...", _set("playback.timeline.asks_for_time", True), "Timeline", "Ctrl+G",
                "Type a time in seconds."),
        Command("Step one frame back", lambda playback: playback.clock.step(-1, playback.timeline.fps), "Timeline",
                "Left", "Stop, and go one frame back."),
        Command("Step one frame forward", lambda playback: playback.clock.step(1, playback.timeline.fps), "Timeline",
                "Right", "Stop, and go one frame forward."),
        Command("Repeat", _toggle("playback.clock.loop"), "Timeline", "",
                "Restart at the end of the playback range; else stop there.", is_on=_is("playback.clock.loop")),
    ),
    (
        Command("Insert keyframe", _call("camera_path.add_keyframe"), "Timeline", "K",
                "Store the present view as a camera keyframe at the present time."),
        Command("Append keyframe", _call("camera_path.append_keyframe"), "Timeline", "Shift+K",
                "Store the present view as a camera keyframe after the last one, and go to its time."),
        Command("Update keyframe", _keyframe(CameraPathEditor.update_keyframe), "Timeline", "",
                "Set the active keyframe to the present view.", _has_keyframe),
        Command("Delete keyframe", _keyframe(CameraPathEditor.delete_keyframe), "Timeline", "Shift+Delete",
                "Delete the active keyframe; Delete does the same while the timeline has the focus.", _has_keyframe),
        Command("Snap keyframe to the drive", _keyframe(CameraPathEditor.snap_keyframe), "Timeline", "",
                "Move the active keyframe to the nearest pose of the recorded drive.", _has_keyframe),
        Command("Previous keyframe", lambda camera_path: camera_path.go_to_next_keyframe(-1), "Timeline",
                ", or Alt+Left", "Go to the previous keyframe and look through it.", _has_path),
        Command("Next keyframe", lambda camera_path: camera_path.go_to_next_keyframe(1), "Timeline",
                ". or Alt+Right", "Go to the next keyframe and look through it.", _has_path),
    ),
    (
        Command("Follow path", lambda viewport: viewport.ride(not viewport.options.follow_path), "Timeline", "V",
                "Look through the camera that moves along the path.", is_on=_is("viewport.options.follow_path")),
        Command("Show the camera path", _toggle("playback.timeline.show_path"), "Timeline", "",
                "Draw the path and its keyframes in the viewport.", is_on=_is("playback.timeline.show_path")),
        Command("Loop the camera path", _loop_path, "Timeline", "", "Continue from the last keyframe to the first.",
                _has_path, lambda document: document.scene.path is not None and document.scene.path.loop),
        Command("Camera path from the drive", _call("camera_path.path_from_drive"), "Timeline", "",
                "Follow the recorded drive with as few keyframes as stay within 5 cm.",
                lambda camera_path: bool(camera_path.rig_cameras)),
        Command("Circle around the target", _call("camera_path.circle_target"), "Timeline", "", timeline.CIRCLE_HELP),
        Command("Reverse the camera path", _call("camera_path.reverse_path"), "Timeline", "",
                timeline.REVERSE_HELP, _has_path),
        Command("Import camera path...", timeline.ask_for_import, "Timeline", "", timeline.IMPORT_HELP),
        Command("Export camera path...", timeline.ask_for_export, "Timeline", "",
                "Write keyframes and interpolation; for other programs see Path in the Timeline panel."),
        Command("Delete camera path", _call("camera_path.delete_path"), "Timeline", "",
                timeline.DELETE_PATH_HELP, _has_path),
    ),
    # View
    (
        Command("Frame the scene", _call("viewport.frame_scene"), "View", "F",
                "Move back until the active layer or actor, or else the whole scene, is visible."),
        Command("Go home", _call("viewport.go_home"), "View", "R or Home", "Return to the initial view of the scene."),
        Command("Show the selection", _toggle("viewport.options.show_selection"), "View", "Shift+S",
                "Tint the selected Gaussians.", is_on=_is("viewport.options.show_selection")),
        Command("Take a screenshot", _call("take_screenshot"), "View", "F12",
                "Save the viewport as PNG in the pictures folder; the log has its path."),
        *(Command(f"Mode: {mode}", _set("viewport.options.look", mode), help="Set the render mode of the viewport.",
                  is_on=_is("viewport.options.look", mode)) for mode in get_args(RenderMode)),
        *(Command(f"Compare: {split}", _set("viewport.options.split", split), help=_COMPARE_HELP,
                  is_on=_is("viewport.options.split", split)) for split in get_args(Split)),
        Command("Play or pause", _call("playback.clock.toggle"), "View", "Space", "Start or stop time."),
        Command("Navigate", _set("viewport.options.tool", ""), "", "Esc", "Leave the tool: a left drag orbits."),
    ),
    # Background jobs
    (
        Command(MAKE_RAINY_TITLE, _call("wet_look.make"), "Scene", "",
                "Transfer views and solve for wet colors in the background; see the Wet look panel.",
                lambda wet_look: wet_look.why_not is None),
        Command("Preview this view in rain", _call("wet_look.preview"), "Scene", "",
                "Transfer the present view, and show it right of the live image.",
                lambda wet_look: wet_look.why_no_preview is None),
        Command("Compare clear and rainy", _call("wet_look.compare"), "View", "",
                "Show the clear scene left and the rainy scene right of a line that can be dragged.",
                lambda document: document.scene.has_wet_colors),
    ),
    # Captures
    (
        Command("Look from the chosen view",
                lambda captures: captures.look_from(captures.chosen), "View", "Shift+V",
                "Move to the pose of the chosen recorded image, with its field of view, and overlay it.",
                _has_capture),
        Command("Look from the next view", lambda captures: captures.step(1), "View", "PageDown",
                "Go to the next image of the capture, of the chosen camera.", _has_capture),
        Command("Look from the previous view", lambda captures: captures.step(-1), "View", "PageUp",
                "Go to the previous image of the capture, of the chosen camera.", _has_capture),
        Command("Show the recorded image", _toggle("captures.show_picture"), "View", "Shift+P",
                "Overlay the recorded image while the camera is at its pose.", _has_capture,
                _is("captures.show_picture")),
        Command("Show recorded cameras", _toggle("captures.show_frustums"), "", "",
                "Show the poses of the capture's images.", _has_capture, _is("captures.show_frustums")),
        Command("Show measured points", _toggle("captures.show_points"), "", "",
                "Show the capture's points (COLMAP, lidar) over the image.", _has_capture,
                _is("captures.show_points")),
        Command("Show matches with another view", _toggle("matching.is_on"), "View", "Shift+M",
                "Find each pixel of the present view in another view of the capture, by its depth.", _has_capture,
                _is("matching.is_on")),
    ),
    # Help
    (
        Command("Find a command...", _set("viewport.options.dialog", "commands"), "Help", "Ctrl+P or Ctrl+Shift+P",
                "Type part of a name; Enter runs it."),
        Command("Keyboard and mouse", _set("viewport.options.dialog", "keys"), "Help", "F1", "All keys on one page."),
        Command("About GSRAIN", _set("viewport.options.dialog", "about"), "Help", "",
                "Version, renderer and references."),
    ),
    (
        Command("Quit", _call("request_quit"), "File", "Ctrl+Q", "Quit; asks first if changes are unsaved."),
    ),
)  # fmt: skip
"""Groups of commands; menus draw a line between two groups."""

ACTIONS = tuple(action for group in ACTION_GROUPS for action in group)
