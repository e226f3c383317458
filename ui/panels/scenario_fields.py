"""Widgets for a scenario's own numbers: the start, each road user and what it does, the controller."""

from typing import TypeVar

import msgspec
from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.drive.scenario.scenario import ScenarioUser
from gsrain_engine.session.drive.wanted_drive import WantedDrive

from ..widgets.fields import field_info, plain_label
from ..widgets.file_dialogs import ask_where_to_save
from ..widgets.names import visible_name
from ..widgets.struct_fields import edited

_Settings = TypeVar("_Settings", bound=msgspec.Struct)

_DRAG_PX, _FASTEST = 300.0, 0.1
"""So far one drags from end to end, and at most so much changes a pixel."""
_START = ("speed_m_s", "left_m", "duration_s", "step_s")
_USER = ("ahead_m", "left_m", "turned_deg", "speed_m_s")


def scenario_fields(wanted: WantedDrive) -> None:
    """Draw them, with a button that saves the scenario."""
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


def ask_where_to_save_scenario(wanted: WantedDrive) -> None:
    """Ask for the scenario's file."""
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
    """Numbers, switches, one of a few words, and settings inside; what holds more is for the file."""
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
    """Draw a field's widget; numbers with decimals are dragged, since their bounds are far apart."""
    value = getattr(settings, name)
    if not isinstance(value, float):
        return edited(settings, name)
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
