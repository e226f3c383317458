"""Table of all commands: of the window with their menus and keys, and of the command line. A new command is a row.

Functions elsewhere are given by their place, such as "ui.panels.capture:ask_for_capture_folder": the table imports
nothing, so that the window opens, and `gsrain --help` prints, at once.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from ..parts import bind_parts

if TYPE_CHECKING:
    from gsrain_engine.editor.editor import Editor
    from gsrain_engine.editor.scene_edits import InstalledEdit

Function = Callable[..., Any] | str
"""A function of the editor's parts that its parameters name, or its place."""


@dataclass(frozen=True)
class Command:
    """A command of the window, and the other ways to do the same."""

    name: str
    """Unique title in menu and palette, starting with a verb."""
    run: Function | None
    """None for its edit, without arguments, as a step of its name."""
    menu: str = ""
    """Title of its menu; "" for commands in palette and keys only."""
    key_names: str = ""
    """Key chords, such as "Ctrl+Shift+Z or Ctrl+Y"; the menu shows the first."""
    help: str = ""
    """One sentence, with the units of any numbers."""
    is_possible: Function = lambda: True
    is_on: Function | None = None
    """State of a toggle command."""
    more: Function | None = None
    """Suffix of the name in the menu, such as the step that undo would revert."""
    edit: str = ""
    """Edit of the scene that it makes (`gsrain_engine.editor.steps`): for `gsrain edit`, `gr.edit` and the history."""
    shell: str = ""
    """Command of `SHELL_COMMANDS` that does the same."""
    python: str = ""
    """Name in `gsrain` that does the same."""
    exists: Function | None = None
    """False leaves it out of menu and palette, such as for a view that there is not."""

    def title(self, editor: "Editor") -> str:
        return self.name if self.more is None else f"{self.name} {_bound(self.more, editor)()}".strip()

    def can_run(self, editor: "Editor") -> bool:
        return _bound(self.is_possible, editor)()

    def is_listed(self, editor: "Editor") -> bool:
        """Return whether menu and palette list it now."""
        return self.exists is None or _bound(self.exists, editor)()

    def is_checked(self, editor: "Editor") -> bool:
        """State of a toggle command."""
        return self.is_on is not None and _bound(self.is_on, editor)()

    def perform(self, editor: "Editor") -> None:
        """Run the command, if that is possible."""
        if not self.can_run(editor):
            return
        if self.run is not None:
            _bound(self.run, editor)()
        else:
            editor.document.edit(self.name, function_at("gsrain_engine.editor.steps:edit_function")(self.edit))


def _bound(function: Function, editor: "Editor") -> Callable[[], Any]:
    return bind_parts(function_at(function) if isinstance(function, str) else function, editor)


def function_at(place: str) -> Callable[..., Any]:
    """Import the function at a place, such as "ui.panels.capture:ask_for_capture_folder"."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def command_named(name: str) -> Command:
    """Find a command by its name. Raises `KeyError` if there is none."""
    found = next((command for command in COMMANDS if command.name == name), None)
    if found is None:
        raise KeyError(f"no command is called {name!r}")
    return found


def help_of(name: str) -> str:
    """Help text of a command, for buttons that do the same."""
    return command_named(name).help


# Functions of commands


def _is(field: str, value: object = True) -> Function:
    """Compare a field of a part, such as "viewport.options.tool"."""
    return lambda editor: attrgetter(field)(editor) == value


def _call(method: str) -> Function:
    """Call a method of a part, such as "document.undo"."""
    return lambda editor: attrgetter(method)(editor)()


def _set(field: str, value: object) -> Function:
    owner, _, name = field.rpartition(".")
    return lambda editor: setattr(attrgetter(owner)(editor), name, value)


def _toggle(field: str) -> Function:
    owner, _, name = field.rpartition(".")
    return lambda editor: setattr(attrgetter(owner)(editor), name, not attrgetter(field)(editor))


def _toggle_rain(field: str, title: str) -> Function:
    def run(document: Any) -> None:
        is_on = not getattr(document.rain, field)
        document.change_rain(f"{title} {'on' if is_on else 'off'}", **{field: is_on})

    return run


def _toggle_haze(document: Any) -> None:
    haze = "medium" if document.rain.haze == "none" else "none"
    document.change_rain(f"Haze {'off' if haze == 'none' else 'on'}", haze=haze)


def _toggle_tool(tool: str) -> Function:
    return lambda viewport: setattr(viewport.options, "tool", "" if viewport.options.tool == tool else tool)


def _toggle_regions(viewport: Any) -> None:
    viewport.options.show_streak_region = viewport.options.show_haze_region = not _shows_regions(viewport)


def _keyframe(method: str) -> Function:
    """Call a method of the camera path with the active keyframe."""
    return lambda camera_path: getattr(camera_path, method)(camera_path.active_key)


# Preconditions


def _has_scene(document: Any) -> bool:
    return bool(document.scene.members)


def _has_member(viewport: Any) -> bool:
    return viewport.active_member is not None


def _chosen_members(viewport: Any) -> str:
    return f"({viewport.chosen_title})" if viewport.chosen_title else ""


def _has_actor(document: Any, viewport: Any) -> bool:
    return any(each.key == viewport.options.member for each in document.scene.actors)


def _has_path(document: Any) -> bool:
    return document.scene.path is not None


def _has_keyframe(camera_path: Any) -> bool:
    return camera_path.active_key is not None


def _has_capture(captures: Any) -> bool:
    return captures.capture is not None


def _plays(rollouts: Any) -> bool:
    return rollouts.playing is not None


def _shows_regions(viewport: Any) -> bool:
    return viewport.options.show_streak_region and viewport.options.show_haze_region


# Rows made from tables


INTENSITIES_MM_H = {"No rain": 0.0, "Light": 1.2, "Moderate": 5.0, "Paper": 8.5, "Heavy": 12.0}
"""Presets of the intensity: commands, and buttons of the Rain panel."""


def set_intensity(document: Any, rate_mm_h: float) -> None:
    document.change_rain(f"Intensity {rate_mm_h:g} mm/h", intensity_mm_h=rate_mm_h)


def intensity_command(name: str) -> Command:
    """Return the command of one of `INTENSITIES_MM_H`."""
    rate = INTENSITIES_MM_H[name]
    return Command(
        f"{name} {rate:g} mm/h" if rate else name,
        lambda document: set_intensity(document, rate),
        "Rain",
        help="Set the rainfall intensity, and nothing else; if it has keyframes, at the present time.",
        is_on=lambda document: document.rain_now.intensity_mm_h == rate,
        edit="change-rain",
        python="Rain",
    )


def _rain_keyframe(title: str, field: str) -> Command:
    def run(document: Any, viewport: Any, playback: Any) -> None:
        function_at("ui.widgets.fields:toggle_keyframe")(document, viewport, playback, field)

    help_text = f"Insert a keyframe of the present {title} at the present time, or remove the one that is there."
    return Command(f"Toggle {title} keyframe", run, "Rain", help=help_text, edit="set-rain-keyframe")


def _follow_ego(name: str, mode: str, help_text: str) -> Command:
    return Command(
        name, lambda rollouts: rollouts.follow(mode), "Drive", "", f"{help_text} Needs a roll-out that plays.", _plays,
        lambda rollouts, viewport: _plays(rollouts) and viewport.chase.mode == mode,
    )  # fmt: skip


VIEW_KEYS = 9
"""Named views that have a key: the first ones."""


def _go_to_view(number: int) -> Command:
    """Return the command of a named view, which counts from 1."""

    def is_there(views: Any) -> bool:
        return len(views.views) >= number

    def name(views: Any) -> str:
        visible_name = function_at("ui.widgets.text:visible_name")
        return f"({visible_name(views.views[number - 1].name)})" if is_there(views) else ""

    return Command(
        f"Go to view {number}", lambda views: views.go_to_number(number - 1), "View", f"Ctrl+{number}",
        "Look from this named view: its camera, and its time and rain if it has them.", is_there, more=name,
        exists=is_there, shell="render", python="view",
    )  # fmt: skip


RENDER_MODE_HELP = {
    "splats": "The image, in the rain. The other modes show the scene without rain.",
    "points": "Each Gaussian as a dot in its color.",
    "ellipsoids": "Gaussians as shaded solids: holes, needles and floaters stand out.",
    "depth": "Distance from the camera, 0.5 to 200 m, as colors.",
    "normals": "Direction of each Gaussian's shortest axis, as colors.",
    "opacity": "Largest alpha of each Gaussian, 0 to 1, as colors.",
    "overdraw": "Fragments drawn per pixel, 0 to 256, blue to red: where a frame's time is spent.",
    "layers": "Each layer and actor in a color of its own.",
}
SPLIT_HELP = {
    "off": "One image.",
    "clear | rainy": "The scene without rain left, as it is right; drag the line between them.",
    "before | after": "The scene before the last edit left, as it is right; drag the line between them.",
    "now | preview": "The scene as it is left, the last preview of Wet look right; drag the line between them.",
}
RENDER_MODES, SPLITS = tuple(RENDER_MODE_HELP), tuple(SPLIT_HELP)

# The window

COMMAND_GROUPS: tuple[tuple[Command, ...], ...] = (
    # Files
    (
        Command("Open...", "ui.commands.actions:ask_what_to_open_scene", "File", "Ctrl+O",
                "Open a scene file, or a scene folder by its scene.json.", python="load"),
        Command("Open built-in street", lambda files: files.open("street"), "File",
                help="A street with cars and trees that needs no download.", python="load"),
    ),
    (
        Command("Import into this scene...", "ui.commands.actions:ask_what_to_import", "File", "Ctrl+Shift+O",
                "Add the layers and actors of other scenes at their positions in the world (meters).", edit="import"),
        Command("Import built-in street", lambda files: files.import_from("street"), "File",
                help="Add the street's layers and its car to this scene.", is_possible=_has_scene, edit="import"),
    ),
    (
        Command("Save", _call("files.save"), "File", "Ctrl+S",
                "Save to the scene folder that was opened or saved last; asks for one if there is none.", _has_scene,
                shell="convert", python="save"),
        Command("Save as...", "ui.commands.actions:ask_where_to_save_scene", "File", "Ctrl+Shift+S",
                "Save to another scene folder, which holds everything.", _has_scene, shell="convert", python="save"),
        Command("Export visible...", "ui.commands.actions:ask_where_to_export", "File", "Ctrl+E",
                "Write what is visible, without hidden layers, actors and Gaussians, to one file (.ply, .spz, .glb, "
                "...); the document stays unsaved.", _has_scene,
                shell="convert", python="save"),
        Command("Revert", _call("files.revert"), "File",
                help="Reload the scene from disk; all changes since it was saved are lost.",
                is_possible=lambda files: files.source is not None),
        Command("Close scene", _call("files.close_scene"), "File", "Ctrl+W",
                "Close the scene; the window stays open.", _has_scene),
    ),
    (
        Command("Open capture folder...", "ui.panels.capture:ask_for_capture_folder", "File",
                help="Show recorded images, cameras and points with the scene: a folder of COLMAP, nerfstudio, "
                "nuScenes, DGP, KITTI, Waymo, RainSense, the street, or of images alone.",
                shell="info", python="capture"),
        Command("Open capture file...", "ui.panels.capture:ask_for_capture_file", "File",
                help="Show recorded images, cameras and points with the scene, from one file: transforms.json, a "
                ".tfrecord of Waymo, a .pkl of MMDetection3D.",
                shell="info", python="capture"),
        Command("Close capture", _call("captures.close_capture"), "File",
                help="Close the capture; the scene stays open.", is_possible=_has_capture),
    ),
    (
        Command("Record timeline...", "ui.panels.record:ask_where_to_record", "File", "Ctrl+R",
                "Render the camera path, or rig cameras, to a video or frames in the background; see the Record panel.",
                _has_scene, shell="render", python="render_video"),
        Command("Render image...", "ui.panels.record:ask_where_to_render_image", "File", "Ctrl+Shift+R",
                "Render the present view at the present time, in the size and with the samples of the Record panel.",
                _has_scene, shell="render", python="render"),
        Command("Draw intensity sheet...", "ui.panels.record:ask_where_to_draw_sheet", "File", "",
                "Draw the present view in five intensities below each other, with what can be seen of each in numbers.",
                _has_scene, shell="render"),
        Command("Publish web page...", "ui.panels.record:ask_where_to_publish", "File", "",
                "Write one HTML file with the scene, its path or drive, and its rain under a slider, for any browser.\n"
                "It has no rain keyframes, rings, spray, water on glass and light of lamps.",
                _has_scene, shell="publish", python="publish"),
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
        Command("Delete selection", "ui.commands.actions:delete_selection", "Edit", "Delete",
                "Delete the selected Gaussians; undo restores them.", "ui.commands.actions:has_selection",
                edit="delete-selected"),
        Command("Hide selection", None, "Edit", "H", "Do not draw the selected Gaussians.",
                "ui.commands.actions:has_selection", edit="hide-selected"),
        Command("Isolate selection", None, "Edit", "Shift+I",
                "Hide everything but the selected Gaussians; locked layers are not changed.",
                "ui.commands.actions:has_selection", edit="isolate-selected"),
        Command("Show all", None, "Edit", "Shift+H", "Draw all hidden Gaussians.",
                lambda document: any(each.marks.hidden for each in document.scene.members), edit="show-all"),
        Command("Duplicate layer or actor", "ui.commands.actions:duplicate_members", "Edit", "Ctrl+D",
                "Copy the chosen layers and actors.", _has_member,
                more=_chosen_members, edit="duplicate"),
        Command("Separate selection", None, "Edit", "Ctrl+J", "Move the selected Gaussians to a new layer.",
                "ui.commands.actions:has_selection", edit="separate"),
        Command("Purge deleted", None, "Edit",
                help="Remove deleted Gaussians from memory and files; undo restores them.",
                is_possible="ui.commands.actions:has_deleted", edit="purge-deleted"),
        Command("Level by ground", None, "Edit", help="Find the largest low plane of the scene and make it level.",
                is_possible=lambda document: bool(document.scene.layers), edit="level-by-ground"),
        Command("Follow actor with camera", lambda viewport: viewport.follow_actor(viewport.options.member),
                "Edit", help="The camera moves and turns with the active actor.", is_possible=_has_actor,
                is_on=lambda viewport: bool(viewport.following.key)),
    ),
    # Selection
    (
        Command("Select all", _call("selection.select_all"), "Select", "Ctrl+A",
                "Select every visible Gaussian of layers and actors that are not locked.", edit="select-all"),
        Command("Select none", _call("selection.select_none"), "Select", "Ctrl+Shift+A", "Clear the selection.",
                lambda selection: not selection.is_empty, edit="select-none"),
        Command("Invert selection", _call("selection.invert"), "Select", "Ctrl+I",
                "Select all visible Gaussians that were not selected.", edit="invert-selection"),
        Command("Grow selection", _call("selection.grow"), "Select", "Ctrl+]",
                "Add Gaussians near the selection, within the distance of the Select panel (meters).",
                lambda selection: not selection.is_empty, edit="select-near"),
        Command("Shrink selection", _call("selection.shrink"), "Select", "Ctrl+[",
                "Deselect Gaussians near unselected ones, within the distance of the Select panel (meters).",
                lambda selection: not selection.is_empty, edit="select-near"),
        Command("Save selection as set", _call("selection.save_set"), "Select",
                help="Store the selection under a name; the Select panel lists the sets.",
                is_possible=lambda selection: not selection.is_empty, edit="save-set"),
    ),
    # Rain
    tuple(map(intensity_command, INTENSITIES_MM_H)),
    (
        Command("Streaks", _toggle_rain("streaks", "Streaks"), "Rain", "", "Draw near drops as streaks.",
                is_on=_is("document.rain.streaks"), edit="change-rain"),
        Command("Haze", _toggle_haze, "Rain", "", "Draw far drops as a medium that extinguishes light.",
                is_on=lambda document: document.rain.haze != "none", edit="change-rain"),
        Command("Shelter under roofs", _toggle_rain("roofs", "Shelter under roofs"), "Rain", "",
                "No rain under bridges, canopies and trees; they are searched for once.",
                is_on=_is("document.rain.roofs"), edit="change-rain"),
        Command("Show rain regions", _toggle_regions, "Rain", "", "Draw the edges of the regions in the viewport.",
                is_on=_shows_regions),
        Command("Edit rain regions", _toggle_tool("Rain regions"), "Rain", "",
                "Drag the faces of the regions of drops and haze.",
                is_on=_is("viewport.options.tool", "Rain regions")),
        Command("Pick drop color", _toggle_tool("Drop color"), "Rain", "",
                "Click a pixel of the viewport or drag a rectangle: its color becomes the drop color.",
                is_on=_is("viewport.options.tool", "Drop color")),
        Command("Reset drop color to sky",
                lambda document: document.change_rain("Drop color from sky", drop_color=None), "Rain", "",
                "Use the mean color of the scene's sky in linear light.",
                lambda document: document.rain.drop_color is not None, edit="change-rain"),
    ),
    (
        _rain_keyframe("intensity", "intensity_mm_h"),
        _rain_keyframe("wind", "wind_m_s"),
        _rain_keyframe("exposure", "exposure_s"),
        Command("Add passing shower", "ui.panels.timeline_tracks:add_passing_shower", "Rain",
                help="Add 60 s of rain from the present time on: smoothly from 0 to 12 mm/h and back.",
                edit="add-shower"),
        Command("Import disdrometer series...", "ui.panels.timeline_tracks:ask_for_rate_file", "Rain",
                help="Make intensity keyframes from measured rain rates.",
                is_possible=lambda calibration: calibration.busy is None),
        Command("Clear rain keyframes", "ui.panels.timeline_tracks:clear_keyframes", "Rain",
                help="Remove all rain keyframes; the values of the Rain panel apply at all times.",
                is_possible=lambda document: bool(document.keyframes.keys), edit="set-rain-keyframes"),
    ),
    # Drives and roll-outs
    (
        Command("Run drive", _call("rollouts.start"), "Drive",
                help="Drive the scenario of the Drive panel through this scene, in the background.",
                is_possible=lambda rollouts: rollouts.why_not is None, shell="drive", python="drive"),
        Command("Drive ego along camera path", None, "Drive", "",
                "For scenes without a recorded drive: the ego vehicle follows the camera path, with a front camera.",
                _has_path, edit="drive-along-path"),
        Command("Open scenario...", "ui.panels.drive:ask_for_scenario", "Drive",
                help="Open a scenario: GSRAIN's YAML, HUGSIM's YAML, or OpenSCENARIO.", shell="drive",
                python="load_scenario"),
        Command("Save scenario...",
                lambda rollouts: function_at("ui.panels.drive:ask_where_to_save_scenario")(rollouts.setup), "Drive",
                help="Write the scenario with the changes of the Drive panel as YAML."),
    ),
    (
        Command("Open roll-out...", "ui.panels.drive:ask_for_rollout", "Drive",
                help="Open a finished drive (JSON lines or Parquet) and play it in the viewport.",
                python="read_rollout"),
        Command("Save roll-out as...", "ui.panels.drive:ask_where_to_save_rollout", "Drive", "",
                "Write the playing roll-out as JSON lines or Parquet.", _plays),
        Command("Render drive video...", "ui.panels.drive:ask_where_to_render_drive", "Drive", "",
                "Render a video of the playing roll-out: front camera, metrics, and a top view.\n"
                "In the background, at the Record panel's frame rate, at most 60 fps.",
                lambda rollouts: rollouts.why_no_video is None, shell="drive"),
        Command("Jump to collision", lambda rollouts: rollouts.jump(rollouts.playing.collision_s), "Drive", "",
                "Stop at the time of the collision.",
                lambda rollouts: rollouts.playing is not None and rollouts.playing.collision_s is not None),
        Command("Jump to smallest TTC", lambda rollouts: rollouts.jump(rollouts.playing.curves.min_ttc_time_s),
                "Drive", "", "Stop at the time of the smallest time to collision.", _plays),
        _follow_ego("Follow ego vehicle", "behind", "Look from 8 m behind and 3 m above."),
        _follow_ego("Look through front camera", "front camera", "Look through the front camera of the ego rig."),
        _follow_ego("Leave ego vehicle", "free", "The camera stays at its position."),
        Command("Close roll-outs", _call("rollouts.close_all"), "Drive", "",
                "Show the scene with its own traffic.", _plays),
    ),
    # Time and the camera path
    (
        Command("Go to range start", lambda playback: playback.clock.seek(playback.span_s[0]), "Timeline",
                "Ctrl+Left", "Go to the start of the playback range."),
        Command("Go to range end", lambda playback: playback.clock.seek(playback.span_s[1]), "Timeline",
                "Ctrl+Right", "Go to the end of the playback range."),
        Command("Go to time...", "ui.panels.timeline:ask_for_time", "Timeline", "Ctrl+G",
                "Type a time in seconds."),
        Command("Step one frame back", lambda playback: playback.clock.step(-1, playback.timeline.fps), "Timeline",
                "Left", "Stop, and go one frame back."),
        Command("Step one frame forward", lambda playback: playback.clock.step(1, playback.timeline.fps), "Timeline",
                "Right", "Stop, and go one frame forward."),
        Command("Loop playback", _toggle("playback.clock.loop"), "Timeline", "",
                "Restart at the end of the playback range; else stop there.", is_on=_is("playback.clock.loop")),
    ),
    (
        Command("Insert camera keyframe", _call("camera_path.add_keyframe"), "Timeline", "K",
                "Store the present view as a camera keyframe at the present time.", edit="set-keyframe"),
        Command("Append camera keyframe", _call("camera_path.append_keyframe"), "Timeline", "Shift+K",
                "Store the present view as a camera keyframe after the last one, and go to its time.",
                edit="set-keyframe"),
        Command("Update camera keyframe", _keyframe("update_keyframe"), "Timeline", "",
                "Set the active keyframe to the present view.", _has_keyframe, edit="set-keyframe"),
        Command("Delete camera keyframe", _keyframe("delete_keyframe"), "Timeline", "Shift+Delete",
                "Delete the active keyframe of the camera; Delete does the same while the timeline has the focus.",
                _has_keyframe, edit="delete-keyframe"),
        Command("Copy keyframe", "ui.commands.actions:copy_keyframe", "Timeline", "Ctrl+C",
                "Copy the active keyframe, of the camera or of a track of the rain, with its easing."),
        Command("Paste keyframe", "ui.commands.actions:paste_keyframe", "Timeline", "Ctrl+V",
                "Insert the copied keyframe at the present time.", edit="copy-rain-keyframe"),
        Command("Snap keyframe to recorded drive", _keyframe("snap_keyframe"), "Timeline", "",
                "Move the active keyframe of the camera to the nearest pose of the recording vehicle's camera.",
                _has_keyframe, edit="snap-keyframe"),
        Command("Previous keyframe", lambda camera_path: camera_path.go_to_next_keyframe(-1), "Timeline",
                ", or Alt+Left", "Go to the previous keyframe and look through it.", _has_path),
        Command("Next keyframe", lambda camera_path: camera_path.go_to_next_keyframe(1), "Timeline", ". or Alt+Right",
                "Go to the next keyframe and look through it.", _has_path),
    ),
    (
        Command("Follow path", lambda viewport: viewport.ride(not viewport.options.follow_path), "Timeline", "V",
                "Look through the camera that moves along the path: your own, else the ego vehicle's drive.",
                is_on=_is("viewport.options.follow_path")),
        Command("Show camera path", _toggle("playback.timeline.show_path"), "Timeline", "",
                "Draw the path and its keyframes in the viewport.", is_on=_is("playback.timeline.show_path")),
        Command("Closed camera path", "ui.commands.actions:loop_path", "Timeline", "",
                "Continue from the last keyframe to the first.", _has_path,
                lambda document: document.scene.path is not None and document.scene.path.loop, edit="change-path"),
        Command("Camera path from recorded drive", _call("camera_path.path_from_drive"), "Timeline", "",
                "Follow the recorded drive with as few keyframes as stay within 5 cm.",
                lambda camera_path: bool(camera_path.rig_cameras), edit="set-path"),
        Command("Circle around target", _call("camera_path.circle_target"), "Timeline", "",
                "A closed path of 12 s from the present view, around the point that a left drag orbits.",
                edit="set-path"),
        Command("Reverse camera path", _call("camera_path.reverse_path"), "Timeline", "",
                "Fly the same path backward.", _has_path, edit="reverse-path"),
        Command("Import camera path...", "ui.panels.timeline:ask_for_import", "Timeline", "",
                "Read a camera path: GSRAIN's, nerfstudio's camera_path.json, or 3DGS's cameras.json.",
                edit="set-path"),
        Command("Export camera path...", "ui.panels.timeline:ask_for_export", "Timeline", "",
                "Write keyframes, interpolation and easing; for other programs see Path in the Timeline panel."),
        Command("Delete camera path", _call("camera_path.delete_path"), "Timeline", "",
                "Delete all keyframes; Follow path then uses the scene's own path.", _has_path, edit="set-path"),
    ),
    # View
    (
        Command("Save view as...", _set("viewport.options.dialog", "save view"), "View", "Ctrl+Shift+V",
                "Store the present view, with its time and rain, under a name in the scene's file.",
                lambda views: views.can_save, edit="save-view", python="save_view"),
        *map(_go_to_view, range(1, VIEW_KEYS + 1)),
        Command("Set view to current", lambda views: views.save(views.chosen), "", "",
                "Set the chosen named view to the present one.", lambda views: views.has_chosen, edit="save-view"),
        Command("Rename view", "ui.commands.actions:rename_view", "", "F2",
                "Type another name for the chosen named view.", lambda views: views.has_chosen, edit="rename-view"),
        Command("Delete view", lambda views: views.remove(views.chosen), "", "",
                "Delete the chosen named view; undo restores it.", lambda views: views.has_chosen, edit="remove-view"),
    ),
    (
        Command("Frame selection or scene", _call("viewport.frame_scene"), "View", "F",
                "Move back until the selection, else the chosen layers and actors, else the scene is visible."),
        Command("Go home", _call("viewport.go_home"), "View", "R or Home", "Return to the initial view of the scene."),
        Command("Look from above", _call("viewport.look_from_above"), "View", "7",
                "Show the scene from above, to scale, with +y upwards: a plan, with marks from the Display panel.",
                _has_scene, shell="render"),
        Command("Orthographic view", _toggle("viewport.options.orthographic"), "View", "5",
                "Parallel rays: equal lengths are equally long. Shows the light and wet ground of the rain, without "
                "drops and haze.", _has_scene, _is("viewport.options.orthographic"), shell="render"),
        Command("Highlight selection", _toggle("viewport.options.show_selection"), "View", "Shift+S",
                "Tint the selected Gaussians, and mark the centers of faint ones.",
                is_on=_is("viewport.options.show_selection")),
        Command("Take screenshot", _call("take_screenshot"), "View", "F12",
                "Save the viewport as PNG in the pictures folder; the log has its path."),
        *(Command(f"Mode: {mode}", _set("viewport.options.look", mode), help=RENDER_MODE_HELP[mode],
                  is_on=_is("viewport.options.look", mode)) for mode in RENDER_MODES),
        *(Command(f"Compare: {split}", _set("viewport.options.split", split), help=SPLIT_HELP[split],
                  is_on=_is("viewport.options.split", split)) for split in SPLITS),
        Command("Play or pause", _call("playback.clock.toggle"), "View", "Space", "Start or stop time."),
        Command("Navigate", _set("viewport.options.tool", ""), "", "Esc", "Leave the tool: a left drag orbits."),
    ),
    # Background jobs
    (
        Command("Apply wet look", _call("wet_look.make"), "Scene", "",
                "Transfer views and solve for wet colors in the background; see the Wet look panel.",
                lambda wet_look: wet_look.why_not is None, edit="wet-look", python="wet"),
        Command("Preview this view in rain", _call("wet_look.preview"), "Scene", "",
                "Transfer the present view, and show it right of the live image.",
                lambda wet_look: wet_look.why_no_preview is None),
        Command("Compare clear and rainy", _call("wet_look.compare"), "View", "",
                "Show the clear scene left and the rainy scene right of a line that can be dragged; it needs rain.",
                lambda wet_look: wet_look.why_no_comparison is None),
    ),
    # Captures
    (
        Command("Look from chosen view", lambda captures: captures.look_from(captures.chosen), "View", "Shift+V",
                "Move to the pose of the chosen recorded image, with its field of view, and overlay it.",
                _has_capture),
        Command("Look from next view", lambda captures: captures.step(1), "View", "PageDown",
                "Go to the next image of the capture, of the chosen camera.", _has_capture),
        Command("Look from previous view", lambda captures: captures.step(-1), "View", "PageUp",
                "Go to the previous image of the capture, of the chosen camera.", _has_capture),
        Command("Show recorded image", _toggle("captures.show_picture"), "View", "Shift+P",
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
        Command("Guide", lambda viewport: setattr(viewport.options, "guide", viewport.options.guide_of_focus), "Help",
                "Shift+F1", "The page of the guide about the panel that had the focus last."),
        Command("Find command...", _set("viewport.options.dialog", "commands"), "Help", "Ctrl+P or Ctrl+Shift+P",
                "Type part of a name; Enter runs it."),
        Command("Keyboard and mouse", _set("viewport.options.dialog", "keys"), "Help", "F1", "All keys on one page."),
        Command("What's new", _set("viewport.options.dialog", "news"), "Help", "",
                "The changes of this version in a few lines."),
        Command("About GSRAIN", _set("viewport.options.dialog", "about"), "Help", "",
                "Version, renderer and references."),
    ),
    (
        Command("Quit", _call("request_quit"), "File", "Ctrl+Q", "Quit; asks first if changes are unsaved."),
    ),
)  # fmt: skip
"""Groups of commands; menus draw a line between two groups."""


COMMANDS = tuple(command for group in COMMAND_GROUPS for command in group)


def all_command_groups() -> tuple[tuple[Command, ...], ...]:
    """Return `COMMAND_GROUPS`, and one of the scene edits of installed packages."""
    return (*COMMAND_GROUPS, _commands_of(tuple(function_at("gsrain_engine.editor.steps:added_edits")())))


def all_commands() -> tuple[Command, ...]:
    return tuple(command for group in all_command_groups() for command in group)


@lru_cache(maxsize=4)
def _commands_of(edits: "tuple[InstalledEdit, ...]") -> tuple[Command, ...]:
    """Return the commands of edits; those with the name of another command are omitted and logged."""
    made: dict[str, Command] = {}
    for edit in edits:
        title = edit.declared.title
        if title in made or any(each.name == title for each in COMMANDS):
            function_at("gsrain_engine.plugins:warn_once")(str(edit.extension.unfit(f"there is a command {title!r}")))
        else:
            made[title] = _scene_edit(edit)
    return tuple(made.values())


def _scene_edit(edit: "InstalledEdit") -> Command:
    return Command(
        edit.declared.title, lambda scene_edits: scene_edits.start(edit), "Scene", "", edit.declared.summary,
        lambda scene_edits: scene_edits.is_possible(edit), edit=edit.name,
    )  # fmt: skip


# The command line


SHELL_COMMANDS = {
    "render": ("app.render:render", "Render a scene in the rain: an image, a video, frames, or raw floats."),
    "info": ("app.scene:info", "Print the contents of a scene, a capture or a disdrometer file, and check captures."),
    "convert": ("app.scene:convert", "Convert between scene formats."),
    "edit": ("app.edit:edit", "Edit a scene as the window does: by the steps that its History copies, or others."),
    "export-rain": (
        "app.export_rain:export_rain",
        "Write the rain for other programs: its Gaussians (.ply), or a rainy copy of a recording.",
    ),
    "dataset": ("app.dataset:dataset", "Write a labeled data set in several rains: nuScenes, KITTI or COCO."),
    "publish": ("app.publish:publish", "Write a scene and its rain as one web page: slider, divider, path."),
    "calibrate": ("app.rain:calibrate", "Fit drop numbers, sizes and speeds by intensity to disdrometer files."),
    "disdrometer": ("app.rain:disdrometer", "Measure the simulated rain with a virtual disdrometer."),
    "reconstruct": ("app.train:reconstruct", "Fit Gaussians to a capture: images with cameras, and lidar or points."),
    "transfer": ("app.translate:transfer", "Make clear views of a scene, or the images of a capture, look rainy."),
    "recolor": ("app.train:recolor", "Re-optimize a scene's colors for images with another look; its geometry stays."),
    "sweep": ("app.sweep:sweep", "Run drives or renders for all combinations of scenes, scenarios, rain and agents."),
    "train-transfer": ("app.translate:train_transfer", "Fine-tune CycleGAN-Turbo on clear and rainy images (LoRA)."),
    "drive": ("app.drive:drive", "Test a driver in the rain: a closed loop of scene, rain and agent."),
    "serve": (
        "app.serve:serve",
        "Serve scenes in rain: to a simulator (AlpaSim) as a gRPC service, or to browsers as a page with a live view.",
    ),
    "schema": ("app.schema:schema", "Print the JSON schema of a kind of settings file, for editors of YAML."),
    "doctor": ("app.doctor:doctor", "List which features of GSRAIN work on this machine, and how to get the others."),
}
_CONSISTENCY = """Agreement of neighboring views, before and after a transfer.

Views are warped onto their neighbors by depth. The error after a transfer should equal the error before: differences
between views increase it. Reflections in water depend on the view, so errors outside the water film ("dry") are
reported as well.

The paper's two ablations, without normals (weights of gsrain train-transfer rgb) and without mutual self-attention:

gsrain transfer SCENE -o full --method cyclegan-turbo --weights FILE

gsrain transfer SCENE -o no-normals --method cyclegan-turbo --weights RGB_FILE

gsrain transfer SCENE -o no-attention --method cyclegan-turbo --weights FILE --no-cross-view-attention

gsrain evaluate consistency full no-normals no-attention --contact-sheet ablations.png
"""
EVALUATIONS = {
    "consistency": ("app.evaluate.consistency:consistency", _CONSISTENCY),
    "fid": ("app.evaluate.images:fid", "FID and KID of images to real ones, with confidence intervals."),
    "transfers": ("app.evaluate.transfers:transfers", "Compare transfers, as the paper does: table and figure."),
    "images": ("app.evaluate.images:images", "PSNR, SSIM and LPIPS of images with equal names."),
    "lpips-weights": ("app.evaluate.images:lpips_weights", "Convert LPIPS weights to plain arrays."),
    "inception-weights": ("app.evaluate.images:inception_weights", "Convert Inception weights (FID) to plain arrays."),
    "detection": ("app.evaluate.detection:detection", "Effect of rain on object detectors, by intensity."),
    "lidar": ("app.evaluate.lidar:lidar", "A lidar in rain: true, lost and false returns by range."),
}
"""Commands of `gsrain evaluate`, besides those of entry points."""

BENCHMARKS = {
    "render": ("app.bench:render", "Time frames of fixed scenes, with and without rain."),
    "loading": ("app.bench:loading", "Time writing and reading scenes."),
    "recoloring": ("app.bench:recoloring", "Time recoloring scenes."),
}
"""Commands of `gsrain bench`."""
