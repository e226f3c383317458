"""Widgets for what is driven: the scenario, who drives, in which rain."""

from functools import partial
from pathlib import Path

import msgspec
from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.drive.wanted_drive import WantedDrive
from gsrain_engine.session.session import Session

from ..widgets.fields import field_info, plain_label
from ..widgets.file_dialogs import ask_what_to_open
from ..widgets.square_button import square_button
from ..widgets.struct_fields import ALL_FILES, edited, place

_SCENARIOS = f"Scenarios{{.yaml,.yml,.xosc}},{ALL_FILES}"
_DETECTORS = f"Detectors{{.onnx}},{ALL_FILES}"
_BLIND = ("constant-velocity", "oracle-idm")
"""Agents that look at no pictures and ask nobody."""


def scenario_choice(session: Session) -> None:
    """Pick a shipped scenario, or one from a file."""
    wanted = session.drives.wanted
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


def ask_for_scenario(session: Session) -> None:
    """Ask for a scenario's file."""
    ask_what_to_open("Open a scenario", _SCENARIOS, lambda chosen: session.drives.wanted.load(chosen[0]))


def agent_fields(wanted: WantedDrive) -> None:
    """Pick who drives, and what it needs."""
    wishes, names = wanted.wishes, wanted.agent_names
    plain_label("Agent", field_info("agent", type(wishes)).help)
    present = names.index(wishes.agent) if wishes.agent in names else 0
    changed, at = imgui.combo("##agent", present, names)
    imgui.set_item_tooltip(
        "constant-velocity keeps its speed; oracle-idm knows where everybody is; camera-idm has a detector.\n"
        "Installed packages add their own (entry points gsrain.agents)."
    )
    if changed:
        wanted.wishes = msgspec.structs.replace(wishes, agent=names[at])
    if wanted.wishes.agent in _BLIND:
        return
    place(wanted.wishes, "detector", _DETECTORS, partial(_take_detector, wanted))
    _text(wanted, "description", "found by its name")
    if wanted.wishes.agent != "camera-idm":
        _text(wanted, "url", "none")


def rain_fields(session: Session) -> None:
    wanted = session.drives.wanted
    wishes = edited(wanted.wishes, "rain")
    if wishes.rain == "one intensity":
        wishes = edited(wishes, "intensity_mm_h")
    elif wishes.rain == "as the scene":
        plain_label("", "")
        imgui.text_disabled(f"{session.rain_now.intensity_mm_h:.3g} mm/h")
        imgui.set_item_tooltip("Set it in the Rain panel; a shower is driven at its present intensity.")
    wanted.wishes = edited(wishes, "seed")


def _take_detector(wanted: WantedDrive, text: str) -> None:
    detector = Path(text).expanduser() if text.strip() else None
    wanted.wishes = msgspec.structs.replace(wanted.wishes, detector=detector)


def _text(wanted: WantedDrive, name: str, hint: str) -> None:
    info, value = field_info(name, type(wanted.wishes)), getattr(wanted.wishes, name) or ""
    plain_label(info.title, info.help)
    _, typed = imgui.input_text_with_hint(f"##{name}", hint, value)
    if imgui.is_item_deactivated_after_edit():
        wanted.wishes = msgspec.structs.replace(wanted.wishes, **{name: typed.strip() or None})
    imgui.set_item_tooltip(info.help)
