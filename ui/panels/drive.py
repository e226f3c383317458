"""Drive panel: closed-loop test in the current scene, open roll-outs, and scenario settings."""

from functools import partial
from pathlib import Path
from typing import TypeVar, get_args

import msgspec
from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.editor.drive import DriveSetup, RolloutPlayer
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.drive import LoadedRollout
from gsrain_engine.editor.viewport.camera_follow import ChaseMode
from gsrain_engine.simulation.scenario import ScenarioUser

from ..widgets.draw import color
from ..widgets.fields import (
    ALL_FILES,
    ask_what_to_open,
    ask_where_to_save,
    edit_field,
    field_info,
    path_field,
    plain_label,
    square_button,
)
from ..widgets.text import visible_name
from .drive_plots import curve_colors, drive_metrics
from .jobs import job_fields
from .rain import WARNING

_ICONS = icons_fontawesome_6

_HELP = (
    "Drive through the scene as it is now, with your edits, in the background.\n"
    "The roll-out is opened as soon as it is finished; the scene stays as it is."
)


def drive_panel(session: Editor) -> None:
    wanted = session.drives.settings
    scenario_choice(session)
    if imgui.tree_node("Change the scenario"):
        scenario_fields(wanted)
        imgui.tree_pop()
    agent_fields(wanted)
    rain_fields(session)
    if wanted.problem is not None:
        _warn(wanted.problem)
    _begin(session)
    imgui.separator_text("Roll-outs")
    rollout_fields(session)
    if session.drives.playing is not None and imgui.collapsing_header("Metrics", imgui.TreeNodeFlags_.default_open):
        drive_metrics(session)


def _begin(session: Editor) -> None:
    newest = session.newest_job("drive")
    if newest is not None and newest[1].state == "running":
        imgui.separator_text(newest[1].title)
        job_fields(session, newest[1], newest[0])
        return
    why_not = session.drives.why_not(session)
    imgui.spacing()
    imgui.begin_disabled(why_not is not None)
    if imgui.button(f"{_ICONS.ICON_FA_CAR_SIDE}  Drive###drive", (-1, 1.5 * imgui.get_frame_height())):
        session.drives.start(session)
    imgui.end_disabled()
    imgui.set_item_tooltip(_HELP if why_not is None else why_not)
    if why_not is not None:
        _warn(why_not)
    elif newest is not None and newest[1].state != "finished":
        job_fields(session, newest[1], newest[0])


def _warn(words: str) -> None:
    imgui.push_style_color(imgui.Col_.text, WARNING)
    imgui.text_wrapped(words)
    imgui.pop_style_color()


# Scenario, agent and rain

_SCENARIOS = f"Scenarios{{.yaml,.yml,.xosc}},{ALL_FILES}"
_DETECTORS = f"Detectors{{.onnx}},{ALL_FILES}"
_BLIND = ("constant-velocity", "oracle-idm")  # agents that use neither images nor a server


def scenario_choice(session: Editor) -> None:
    wanted = session.drives.settings
    plain_label("Scenario", wanted.scenario.description or "What happens on the road.")
    names = wanted.scenario_names
    shown = wanted.source if wanted.source in names else Path(wanted.source).name
    beside = imgui.get_frame_height() + imgui.get_style().item_spacing.x
    imgui.set_next_item_width(-beside)
    if imgui.begin_combo("##scenario", f"{shown} *" if wanted.is_changed else shown):
        for name in names:
            if imgui.selectable(name, name == wanted.source)[0]:
                wanted.load(name)
        imgui.end_combo()
    changed = "\n* changed, not saved" if wanted.is_changed else ""
    imgui.set_item_tooltip(f"{wanted.source}\n{wanted.scenario.description}".strip() + changed)
    imgui.same_line()
    if square_button(icons_fontawesome_6.ICON_FA_FOLDER_OPEN, "open scenario"):
        ask_for_scenario(session)
    imgui.set_item_tooltip("Open a scenario: our YAML, HUGSIM's YAML, or OpenSCENARIO.")


def ask_for_scenario(session: Editor) -> None:
    ask_what_to_open("Open a scenario", _SCENARIOS, lambda chosen: session.drives.settings.load(chosen[0]))


def agent_fields(wanted: DriveSetup) -> None:
    settings, names = wanted.settings, wanted.agent_names
    plain_label("Agent", field_info("agent", type(settings)).help)
    present = names.index(settings.agent) if settings.agent in names else 0
    changed, at = imgui.combo("##agent", present, names)
    imgui.set_item_tooltip(
        "constant-velocity keeps its speed; oracle-idm knows where everybody is; camera-idm has a detector.\n"
        "Installed packages add their own (entry points gsrain.agents)."
    )
    if changed:
        wanted.settings = msgspec.structs.replace(settings, agent=names[at])
    if wanted.settings.agent in _BLIND:
        return
    path_field(wanted.settings, "detector", _DETECTORS, partial(_take_detector, wanted))
    _text(wanted, "description", "found by its name")
    if wanted.settings.agent != "camera-idm":
        _text(wanted, "url", "none")


def rain_fields(session: Editor) -> None:
    wanted = session.drives.settings
    settings = edit_field(wanted.settings, "rain")
    if settings.rain == "one intensity":
        settings = edit_field(settings, "intensity_mm_h")
    elif settings.rain == "as the scene":
        plain_label("", "")
        imgui.text_disabled(f"{session.rain_now.intensity_mm_h:.3g} mm/h")
        imgui.set_item_tooltip("Set it in the Rain panel; a shower is driven at its present intensity.")
    wanted.settings = edit_field(settings, "seed")


def _take_detector(wanted: DriveSetup, text: str) -> None:
    detector = Path(text).expanduser() if text.strip() else None
    wanted.settings = msgspec.structs.replace(wanted.settings, detector=detector)


def _text(wanted: DriveSetup, name: str, hint: str) -> None:
    info, value = field_info(name, type(wanted.settings)), getattr(wanted.settings, name) or ""
    plain_label(info.title, info.help)
    _, typed = imgui.input_text_with_hint(f"##{name}", hint, value)
    if imgui.is_item_deactivated_after_edit():
        wanted.settings = msgspec.structs.replace(wanted.settings, **{name: typed.strip() or None})
    imgui.set_item_tooltip(info.help)


# Open roll-outs

_KINDS = "Roll-outs{.jsonl,.parquet}"
_VIDEOS = "MP4{.mp4},WebM{.webm}"

VIDEO_HELP = (
    "Film the drive that plays, as `gsrain drive` does: what the front camera sees, figures, and all from above.\n"
    "In the background, with the Record panel's frame rate, at most 60 a second."
)

_MODES: dict[ChaseMode, str] = {
    "behind": "8 m behind the ego vehicle and 3 m up; look around as you like, click again to come back.",
    "front camera": "Through the rig's camera that looks ahead; a drag leaves it.",
    "free": "Where you fly.",
}


def rollout_fields(session: Editor) -> None:
    drives = session.drives
    third = (imgui.get_content_region_avail().x - 2 * imgui.get_style().item_spacing.x) / 3
    if imgui.button(f"{_ICONS.ICON_FA_FOLDER_OPEN}  Open...###open roll-out", (third, 0)):
        ask_for_rollout(session)
    imgui.set_item_tooltip("Open a finished drive (JSON lines), such as `gsrain drive` writes; or drop it here.")
    imgui.same_line()
    imgui.begin_disabled(drives.playing is None)
    if imgui.button(f"{_ICONS.ICON_FA_FLOPPY_DISK}  Save as...###save roll-out", (third, 0)):
        ask_where_to_save_rollout(session)
    imgui.set_item_tooltip("Write the one that plays as JSON lines or Parquet.")
    imgui.end_disabled()
    imgui.same_line()
    why_not = drives.why_no_video(session)
    imgui.begin_disabled(why_not is not None)
    if imgui.button(f"{_ICONS.ICON_FA_FILM}  Film...###film roll-out", (third, 0)):
        ask_where_to_video(session)
    imgui.end_disabled()
    imgui.set_item_tooltip(why_not or VIDEO_HELP)
    if not drives.opened:
        imgui.text_wrapped("None is open. Drive, or open a finished drive: it plays in the view, on the timeline.")
        return
    colors = curve_colors(drives.opened)
    for number, (opened, hue) in enumerate(zip(drives.opened, colors, strict=True)):
        _row(session, number, opened, color(hue))
    if drives.trouble is not None:
        imgui.push_style_color(imgui.Col_.text, WARNING)
        imgui.text_wrapped(drives.trouble)
        imgui.pop_style_color()
    _jumps(session)
    _camera(session)
    _display_options(drives)


def ask_for_rollout(session: Editor) -> None:
    kinds = f"{_KINDS},{ALL_FILES}"

    def take(chosen: list[Path]) -> None:
        for path in chosen:
            session.drives.open(session, path)

    ask_what_to_open("Open a roll-out", kinds, take, several=True)


def ask_where_to_save_rollout(session: Editor) -> None:
    ask_where_to_save("Save the roll-out", _KINDS, lambda chosen: session.drives.save_as(session, chosen[0]))


def ask_where_to_video(session: Editor) -> None:
    ask_where_to_save("Film the drive", _VIDEOS, lambda chosen: session.drives.video_to(session, chosen[0]))


def _row(session: Editor, number: int, opened: LoadedRollout, hue: int) -> None:
    drives, height = session.drives, imgui.get_frame_height()
    imgui.push_id(number)
    at, width = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x
    room = width - height - imgui.get_style().item_spacing.x
    if imgui.selectable("##play", opened is drives.playing, size=ImVec2(room, height))[0]:
        drives.play(session, opened)
    where = "not saved" if opened.path is None else str(opened.path)
    imgui.set_item_tooltip(
        f"{opened.title}, seed {opened.rollout.seed}, in {opened.rollout.scene!r}\n{where}\nClick: play it in the view."
    )
    draw, low = imgui.get_window_draw_list(), at.y + (height - imgui.get_text_line_height()) / 2
    side = 0.55 * imgui.get_text_line_height()
    top = at.y + (height - side) / 2
    draw.add_rect_filled(ImVec2(at.x + 4, top), ImVec2(at.x + 4 + side, top + side), hue, 2.0)
    draw.push_clip_rect(at, ImVec2(at.x + room, at.y + height), True)
    draw.add_text(ImVec2(at.x + side + 12, low), imgui.get_color_u32(imgui.Col_.text), opened.title)
    draw.pop_clip_rect()
    imgui.same_line()
    if square_button(_ICONS.ICON_FA_XMARK, "close"):
        drives.close(session, opened)
    imgui.set_item_tooltip("Close it; after the last one the scene comes back.")
    imgui.pop_id()


def _jumps(session: Editor) -> None:
    drives = session.drives
    playing = drives.playing
    if playing is None:
        return
    half = (imgui.get_content_region_avail().x - imgui.get_style().item_spacing.x) / 2
    hit = playing.collision_s
    imgui.begin_disabled(hit is None)
    if imgui.button(f"{_ICONS.ICON_FA_CAR_BURST}  Collision###collision", (half, 0)) and hit is not None:
        drives.jump(session, hit)
    imgui.end_disabled()
    words = "Nothing was hit." if hit is None else f"Go to {hit:.2f} s, where {playing.metrics.collided_with} was hit."
    imgui.set_item_tooltip(words)
    imgui.same_line()
    critical = playing.curves.min_ttc_time_s
    if imgui.button(f"{_ICONS.ICON_FA_STOPWATCH}  Smallest TTC###smallest ttc", (half, 0)):
        drives.jump(session, critical)
    least = float(playing.curves.ttc_s.min())
    imgui.set_item_tooltip(f"Go to {critical:.2f} s, where the time to collision is {least:.2f} s (from 0 to 10 s).")


def _camera(session: Editor) -> None:
    chase = session.drives.chase
    imgui.align_text_to_frame_padding()
    imgui.text("Camera")
    for mode in get_args(ChaseMode):
        imgui.same_line()
        if imgui.radio_button(mode, chase.mode == mode):
            session.drives.follow(session, mode)
        imgui.set_item_tooltip(_MODES[mode])


def _display_options(drives: RolloutPlayer) -> None:
    _, drives.show_boxes = imgui.checkbox("Boxes", drives.show_boxes)
    imgui.set_item_tooltip(
        "Draw everybody's box with its name and its speed in m/s; red is who is hit.\n"
        "From the front camera also what the agent has detected, with the distance (m) of whom it follows."
    )
    imgui.same_line()
    _, drives.show_plan = imgui.checkbox("Plan", drives.show_plan)
    imgui.set_item_tooltip("Draw the planned points of the present step on the road, 0.5 s apart, and the driven way.")
    imgui.same_line()
    _, drives.show_ego_car = imgui.checkbox("Ego car", drives.show_ego_car)
    imgui.set_item_tooltip("Show a body for the ego vehicle; its own cameras never see it.")
    imgui.same_line()
    _, drives.rain_as_driven = imgui.checkbox("Its rain", drives.rain_as_driven)
    imgui.set_item_tooltip("On: the rain that was driven in. Off: the scene's own, as the Rain panel sets it.")


# Scenario settings

_Settings = TypeVar("_Settings", bound=msgspec.Struct)
_DRAG_PX, _FASTEST = 300.0, 0.1  # drag distance over the whole range in pixels, and the largest change per pixel
_START = ("speed_m_s", "left_m", "duration_s", "step_s")
_USER = ("ahead_m", "left_m", "turned_deg", "speed_m_s")


def scenario_fields(wanted: DriveSetup) -> None:
    scenario = wanted.scenario
    for name in _START:
        scenario = _field(scenario, name)
    wanted.change(scenario)
    for number, user in enumerate(wanted.scenario.road_users):
        imgui.push_id(number)
        if imgui.tree_node_ex(
            f"{visible_name(user.id)}: {_kind(user.behaviour)}###user", imgui.TreeNodeFlags_.default_open
        ):
            wanted.change_user(number, _user(user))
            imgui.tree_pop()
        imgui.pop_id()
    if imgui.tree_node("Controller"):
        controller = _all_fields(wanted.scenario.controller)
        wanted.change(msgspec.structs.replace(wanted.scenario, controller=controller))
        imgui.tree_pop()
    if imgui.button(f"{icons_fontawesome_6.ICON_FA_FLOPPY_DISK}  Save the scenario...###save scenario", (-1, 0)):
        ask_where_to_save_scenario(wanted)
    imgui.set_item_tooltip("As YAML, which `gsrain drive` and this panel open again.")


def ask_where_to_save_scenario(wanted: DriveSetup) -> None:
    ask_where_to_save("Save the scenario", "Scenario{.yaml}", lambda chosen: wanted.save(chosen[0]))


def _user(user: ScenarioUser) -> ScenarioUser:
    imgui.text_disabled(f"{user.model}, {user.class_name}")
    imgui.set_item_tooltip("What it looks like and what it is; set in the scenario's file.")
    for name in _USER:
        user = _field(user, name)
    if user.behaviour.__struct_fields__:
        imgui.separator_text(_kind(user.behaviour))
    behaviour = _all_fields(user.behaviour)
    return user if behaviour is user.behaviour else msgspec.structs.replace(user, behaviour=behaviour)


def _all_fields(settings: _Settings) -> _Settings:
    """Draw numbers, toggles, choices and nested settings; other values are edited in the file."""
    for name in settings.__struct_fields__:
        value = getattr(settings, name)
        if isinstance(value, msgspec.Struct):
            imgui.push_id(name)
            inside = _all_fields(value)
            imgui.pop_id()
            settings = settings if inside is value else msgspec.structs.replace(settings, **{name: inside})
        elif isinstance(value, bool | int | float) or value in field_info(name, type(settings)).choices:
            settings = _field(settings, name)
    return settings


def _field(settings: _Settings, name: str) -> _Settings:
    """Draw a field's widget; floats are dragged, since their bounds are far apart."""
    value = getattr(settings, name)
    if not isinstance(value, float):
        return edit_field(settings, name)
    info = field_info(name, type(settings))
    plain_label(f"{info.title} ({info.unit})" if info.unit else info.title, info.help)
    speed = min((info.high - info.low) / _DRAG_PX, _FASTEST)
    changed, value = imgui.drag_float(
        f"##{name}", value, speed, info.low, info.high, "%.4g", imgui.SliderFlags_.always_clamp
    )
    imgui.set_item_tooltip(f"{info.help}\n{info.low:g} to {info.high:g}. Drag; double click: type.".strip())
    return msgspec.structs.replace(settings, **{name: value}) if changed else settings


def _kind(behaviour: msgspec.Struct) -> str:
    return str(behaviour.__struct_config__.tag)
