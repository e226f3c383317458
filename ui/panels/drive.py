"""Drive panel: closed-loop test in the current scene, open roll-outs, and scenario settings."""

from functools import partial
from pathlib import Path
from typing import TypeVar

import msgspec
from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.drive import DriveSetup, RolloutPlayer
from gsrain_engine.editor.jobs.drive import LoadedRollout
from gsrain_engine.editor.jobs.job import JobRunner
from gsrain_engine.editor.viewport.camera_follow import ChaseMode
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.fields import field_of
from gsrain_engine.simulation.agents.registry import SHIPPED_AGENTS, options_used_by
from gsrain_engine.simulation.scenario import ScenarioUser
from gsrain_engine.simulation.scenario_io import scenario_suffixes

from ..commands.table import help_of
from ..widgets.draw import color
from ..widgets.fields import (
    button,
    checkbox,
    edit_choice,
    edit_field,
    field_label,
    plain_label,
    share_of_width,
    square_button,
    warn,
)
from ..widgets.file_dialogs import ALL_FILES, ask_what_to_open, ask_where_to_save, path_field
from ..widgets.numbers import in_bounds
from ..widgets.text import shortened, visible_name
from .drive_plots import curve_colors, drive_metrics
from .jobs import job_fields

_ICONS = icons_fontawesome_6
_DETECTORS = f"Detectors{{.onnx}},{ALL_FILES}"
_ROLLOUTS = "Roll-outs{.jsonl,.parquet}"

_HELP = (
    "Drive through the present scene, with your edits, in the background.\n"
    "The roll-out opens when it is finished; the scene does not change."
)
_AGENT_HELP = "\n".join(f"{name} {agent.help}." for name, agent in SHIPPED_AGENTS.items()) + (
    "\nInstalled packages can add their own."
)
_CHASE_HELP: dict[ChaseMode, str] = {
    "behind": "8 m behind the ego vehicle and 3 m above it; a drag looks around, another click returns.",
    "front camera": "The front camera of the rig; a drag leaves it.",
    "free": "Free flight.",
}


def drive_panel(document: Document, viewport: ViewportState, rollouts: RolloutPlayer, jobs: JobRunner) -> None:
    setup = rollouts.setup
    _scenario_choice(rollouts)
    if imgui.tree_node("Change scenario"):
        _scenario_fields(setup)
        imgui.tree_pop()
    _agent_fields(setup)
    settings = edit_field(setup.settings, "rain")
    if settings.rain == "one intensity":
        settings = edit_field(settings, "intensity_mm_h")
    elif settings.rain == "as the scene":
        plain_label("", "")
        imgui.text_disabled(f"{document.rain_now.intensity_mm_h:.3g} mm/h")
        imgui.set_item_tooltip("Set in the Rain panel; rain keyframes are ignored: the present intensity is used.")
    setup.settings = edit_field(settings, "seed")
    warn(setup.error)
    _start(viewport, rollouts, jobs)
    imgui.separator_text("Roll-outs")
    _rollouts(viewport, rollouts)
    if rollouts.playing is not None and imgui.collapsing_header("Metrics", imgui.TreeNodeFlags_.default_open):
        drive_metrics(rollouts)


# Dialogs


def ask_for_scenario(rollouts: RolloutPlayer) -> None:
    kinds = f"Scenarios{{{','.join(scenario_suffixes())}}},{ALL_FILES}"
    ask_what_to_open("Open scenario", kinds, lambda chosen: rollouts.setup.load(chosen[0]))


def ask_where_to_save_scenario(setup: DriveSetup) -> None:
    kinds, name = "Scenario{.yaml}", "scenario.yaml"
    ask_where_to_save("Save scenario", kinds, lambda chosen: setup.save(chosen[0]), proposed=name)


def ask_for_rollout(rollouts: RolloutPlayer) -> None:
    def take(chosen: list[Path]) -> None:
        for path in chosen:
            rollouts.open(path)

    ask_what_to_open("Open roll-out", f"{_ROLLOUTS},{ALL_FILES}", take, several=True)


def ask_where_to_save_rollout(rollouts: RolloutPlayer) -> None:
    save = rollouts.save_as
    ask_where_to_save(
        "Save roll-out", _ROLLOUTS, lambda chosen: save(chosen[0]), proposed="drive.jsonl", confirms=False
    )


def ask_where_to_render_drive(rollouts: RolloutPlayer) -> None:
    kinds = "MP4{.mp4},WebM{.webm}"
    render, title = rollouts.video_to, "Render drive video"
    ask_where_to_save(title, kinds, lambda chosen: render(chosen[0]), proposed="drive.mp4", confirms=False)


# Start of a drive


def _start(viewport: ViewportState, rollouts: RolloutPlayer, jobs: JobRunner) -> None:
    newest = jobs.newest("drive")
    why_not = rollouts.why_not
    imgui.spacing()
    height = 1.5 * imgui.get_frame_height()
    if button(f"{_ICONS.ICON_FA_CAR_SIDE}  Run drive###drive", _HELP, width=-1, height=height, why_not=why_not):
        rollouts.start()
    if why_not is not None:
        warn(why_not)
    if newest is not None and newest.state != "finished":
        imgui.separator_text(newest.title)
        job_fields(viewport, jobs, newest)


def _scenario_choice(rollouts: RolloutPlayer) -> None:
    setup = rollouts.setup
    plain_label("Scenario", setup.scenario.description or "Road users, rain, start and duration of the test.")
    names, source = setup.scenario_names, setup.source
    title = source if source in names else Path(source).name
    imgui.set_next_item_width(-imgui.get_frame_height() - imgui.get_style().item_spacing.x)
    if imgui.begin_combo("##scenario", f"{title} *" if setup.is_changed else title):
        for name in names:
            if imgui.selectable(name, name == source)[0]:
                setup.load(name)
        imgui.end_combo()
    changed = "\n* changed, not saved" if setup.is_changed else ""
    imgui.set_item_tooltip(f"{setup.source}\n{setup.scenario.description}".strip() + changed)
    imgui.same_line()
    if square_button(_ICONS.ICON_FA_FOLDER_OPEN, "open scenario"):
        ask_for_scenario(rollouts)
    imgui.set_item_tooltip(help_of("Open scenario..."))


def _agent_fields(setup: DriveSetup) -> None:
    setup.settings = edit_choice(setup.settings, "agent", setup.agent_names, _AGENT_HELP)
    used = options_used_by(setup.settings.agent)
    if "detector" in used:
        path_field(setup.settings, "detector", _DETECTORS, partial(_take_detector, setup))
    if "description" in used:
        _text(setup, "description", "found by its name")
    if "url" in used:
        _text(setup, "url", "none")


def _take_detector(setup: DriveSetup, detector: Path | None) -> None:
    setup.settings = msgspec.structs.replace(setup.settings, detector=detector)


def _text(setup: DriveSetup, name: str, hint: str) -> None:
    info = field_label(name, type(setup.settings))
    _, typed = imgui.input_text_with_hint(f"##{name}", hint, getattr(setup.settings, name) or "")
    if imgui.is_item_deactivated_after_edit():
        setup.settings = msgspec.structs.replace(setup.settings, **{name: typed.strip() or None})
    imgui.set_item_tooltip(info.help)


# Open roll-outs


def _rollouts(viewport: ViewportState, rollouts: RolloutPlayer) -> None:
    third = share_of_width(3)
    help_text = "Open a finished drive (JSON lines or Parquet), or drop it on the window."
    if button(f"{_ICONS.ICON_FA_FOLDER_OPEN}  Open...###open roll-out", help_text, width=third):
        ask_for_rollout(rollouts)
    imgui.same_line()
    title = f"{_ICONS.ICON_FA_FLOPPY_DISK}  Save as...###save roll-out"
    if button(title, help_of("Save roll-out as..."), width=third, enabled=rollouts.playing is not None):
        ask_where_to_save_rollout(rollouts)
    imgui.same_line()
    title, why_not = f"{_ICONS.ICON_FA_FILM}  Video...###film roll-out", rollouts.why_no_video
    if button(title, help_of("Render drive video..."), width=third, why_not=why_not):
        ask_where_to_render_drive(rollouts)
    if not rollouts.opened:
        imgui.text_wrapped("None is open. Drive, or open a finished drive, to play it in the viewport and timeline.")
        return
    for number, (opened, hue) in enumerate(zip(rollouts.opened, curve_colors(rollouts.opened), strict=True)):
        imgui.push_id(number)
        _row(rollouts, opened, color(hue))
        imgui.pop_id()
    if rollouts.is_placing:
        imgui.text_disabled("Finding its road in the scene; then it plays.")
    warn(rollouts.why_hidden)
    _jumps(rollouts)
    imgui.align_text_to_frame_padding()
    imgui.text("Camera")
    for mode, help_text in _CHASE_HELP.items():
        imgui.same_line()
        if imgui.radio_button(mode, viewport.chase.mode == mode):
            rollouts.follow(mode)
        imgui.set_item_tooltip(help_text)
    rollouts.show_boxes = checkbox(
        "Boxes", rollouts.show_boxes,
        "Draw boxes of all road users with name and speed in m/s; a collision partner is red.\n"
        "In the front camera, also the agent's detections, with the distance (m) of its leader.",
    )  # fmt: skip
    imgui.same_line()
    help_text = "Draw the planned points of the present step on the road, 0.5 s apart, and the driven path."
    rollouts.show_plan = checkbox("Plan", rollouts.show_plan, help_text)
    imgui.same_line()
    help_text = "Draw a body for the ego vehicle; it is invisible in its own cameras."
    rollouts.show_ego_car = checkbox("Ego car", rollouts.show_ego_car, help_text)
    imgui.same_line()
    help_text = "On: the rain of the drive. Off: the scene's rain, as set in the Rain panel."
    rollouts.rain_as_driven = checkbox("Rain of the drive", rollouts.rain_as_driven, help_text)


def _row(rollouts: RolloutPlayer, opened: LoadedRollout, hue: int) -> None:
    height = imgui.get_frame_height()
    at, width = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x
    room = width - height - imgui.get_style().item_spacing.x
    if imgui.selectable("##play", opened is rollouts.playing, size=ImVec2(room, height))[0]:
        rollouts.play(opened)
    path = "not saved" if opened.path is None else str(opened.path)
    imgui.set_item_tooltip(
        f"{opened.title}, seed {opened.rollout.seed}, in {opened.rollout.scene!r}\n"
        f"{visible_name(opened.outcome)}\n{path}\nClick: play it."
    )
    draw, low = imgui.get_window_draw_list(), at.y + (height - imgui.get_text_line_height()) / 2
    side = 0.55 * imgui.get_text_line_height()
    top = at.y + (height - side) / 2
    draw.add_rect_filled(ImVec2(at.x + 4, top), ImVec2(at.x + 4 + side, top + side), hue, 2.0)
    title = shortened(opened.title, room - side - 12)
    draw.add_text(ImVec2(at.x + side + 12, low), imgui.get_color_u32(imgui.Col_.text), title)
    imgui.same_line()
    if square_button(_ICONS.ICON_FA_XMARK, "close"):
        rollouts.close(opened)
    imgui.set_item_tooltip("Close it; without roll-outs the scene has its own traffic.")


def _jumps(rollouts: RolloutPlayer) -> None:
    half = share_of_width(2)
    if (playing := rollouts.playing) is None:
        return
    hit, critical = playing.collision_s, playing.curves.min_ttc_time_s
    why_not = "There is none." if hit is None else None
    help_text = "Go to the time of the collision."
    if hit is not None:
        help_text = f"Go to {hit:.2f} s, the collision with {playing.metrics.collided_with}."
    title = f"{_ICONS.ICON_FA_CAR_BURST}  Collision###collision"
    if button(title, help_text, width=half, why_not=why_not) and hit is not None:
        rollouts.jump(hit)
    imgui.same_line()
    smallest = float(playing.curves.ttc_s.min())
    help_text = f"Go to {critical:.2f} s, where the time to collision is {smallest:.2f} s (from 0 to 10 s)."
    if button(f"{_ICONS.ICON_FA_STOPWATCH}  Smallest TTC###smallest ttc", help_text, width=half):
        rollouts.jump(critical)


# Scenario settings

_Settings = TypeVar("_Settings", bound=msgspec.Struct)
_DRAG_PX, _FASTEST = 300.0, 0.1  # drag distance over the whole range in pixels, and the largest change per pixel
_START = ("speed_m_s", "left_m", "duration_s", "step_s", "friction")
_USER = ("ahead_m", "left_m", "turned_deg", "speed_m_s")


def _scenario_fields(setup: DriveSetup) -> None:
    scenario = setup.scenario
    for name in _START:
        scenario = _field(scenario, name)
    setup.change(scenario)
    for number, user in enumerate(setup.scenario.road_users):
        imgui.push_id(number)
        title = f"{visible_name(user.id)}: {_kind(user.behaviour)}###user"
        if imgui.tree_node_ex(title, imgui.TreeNodeFlags_.default_open):
            setup.change_user(number, _user(user))
            imgui.tree_pop()
        imgui.pop_id()
    if imgui.tree_node("Path tracking"):
        controller = _all_fields(setup.scenario.controller)
        setup.change(msgspec.structs.replace(setup.scenario, controller=controller))
        imgui.tree_pop()
    title = f"{_ICONS.ICON_FA_FLOPPY_DISK}  Save scenario...###save scenario"
    if button(title, help_of("Save scenario..."), width=-1):
        ask_where_to_save_scenario(setup)


def _user(user: ScenarioUser) -> ScenarioUser:
    name = Path(user.model).name if Path(user.model).is_absolute() else user.model.replace("saloon", "sedan")
    imgui.text_disabled(f"{name}, {user.class_name}")
    imgui.set_item_tooltip(f"Its model ({user.model}) and class; set in the scenario's file.")
    for name in _USER:
        user = _field(user, name)
    if user.behaviour.__struct_fields__:
        imgui.separator_text(_kind(user.behaviour))
    behaviour = _all_fields(user.behaviour)
    return user if behaviour is user.behaviour else msgspec.structs.replace(user, behaviour=behaviour)


def _kind(behaviour: msgspec.Struct) -> str:
    return str(behaviour.__struct_config__.tag)


def _all_fields(settings: _Settings) -> _Settings:
    """Draw numbers, toggles, choices and nested settings; other values are edited in the file."""
    for name in settings.__struct_fields__:
        value = getattr(settings, name)
        if isinstance(value, msgspec.Struct):
            imgui.push_id(name)
            inside = _all_fields(value)
            imgui.pop_id()
            settings = settings if inside is value else msgspec.structs.replace(settings, **{name: inside})
        elif isinstance(value, bool | int | float) or value in field_of(type(settings), name).choices:
            settings = _field(settings, name)
    return settings


def _field(settings: _Settings, name: str) -> _Settings:
    """Draw a field's widget; floats are dragged, since their bounds are far apart."""
    value = getattr(settings, name)
    if not isinstance(value, float):
        return edit_field(settings, name)
    info = field_label(name, type(settings))
    speed = min((info.high - info.low) / _DRAG_PX, _FASTEST)
    changed, value = imgui.drag_float(f"##{name}", value, speed, info.low, info.high, "%.4g")
    value = in_bounds(changed, value, info.low, info.high, info.unit)
    imgui.set_item_tooltip(f"{info.help}\n{info.low:g} to {info.high:g}. Drag; double click: type.".strip())
    return msgspec.structs.replace(settings, **{name: value}) if changed else settings
