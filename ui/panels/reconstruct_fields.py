"""From the open capture to Gaussians, and from pictures to their colours: settings, and what starts the jobs."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
from imgui_bundle import imgui

from gsrain_engine.reconstruct.training.settings import TrainingSettings, load_settings, settings_names
from gsrain_engine.session.jobs.recoloring import Recoloring
from gsrain_engine.session.jobs.reconstruction import Reconstruction
from gsrain_engine.session.session import Session

from ..pages.file_dialogs import ask_what_to_open
from ..widgets.fields import field_info, plain_label


@dataclass(slots=True)
class _Chosen:
    """The settings of the next reconstruction; they are no part of the document."""

    preset: str
    settings: TrainingSettings


_chosen = _Chosen("laptop", load_settings("laptop"))
_PRESETS = {
    "draft": "A first look: two minutes on two processor cores.",
    "laptop": "Some ten minutes on two processor cores.",
    "full": "For a CUDA GPU with gsplat: 30,000 steps at full size.",
}
_NUMBERS = {"steps": 50, "width_px": 16, "gaussians": 5000, "held_out": 1}
"""Whole numbers that are shown, each with the step of its buttons."""


def reconstruct_fields(session: Session) -> None:
    """Choose settings, start."""
    captures = session.captures
    _preset()
    for name, step in _NUMBERS.items():
        _number(name, step)
    for name in ("density", "sh_degree"):
        _choice(name)
    capture = captures.capture
    if capture is not None and not capture.has_poses:
        imgui.text_wrapped("Nothing tells where the cameras stood: let COLMAP find it, and open its folder.")
        return
    is_busy = bool(session.running_jobs) or session.staged is not None
    imgui.begin_disabled(is_busy or captures.path is None)
    if imgui.button("Reconstruct", (-1, 0)) and captures.path is not None:
        session.start_task(Reconstruction(captures.path, _chosen.settings))
    imgui.end_disabled()
    imgui.set_item_tooltip(
        "Fit Gaussians to the capture in the background. Snapshots come into the view meanwhile; undo brings the "
        "present scene back. A report with the held-out views stays in the Jobs panel."
    )
    imgui.begin_disabled(is_busy or captures.path is None or not session.scene.gaussian_count)
    if imgui.button("Recolour the scene to these pictures", (-1, 0)) and captures.path is not None:
        session.start_task(Recoloring(session.scene, session.files.known, captures.path))
    imgui.set_item_tooltip(
        "Solve for wet colours in which the present scene looks like the capture's pictures; its cameras must be in "
        "the scene's axes. The clear colours stay; one step, undo takes it back."
    )
    if imgui.button("Recolour to other pictures...", (-1, 0)) and captures.path is not None:
        ask_what_to_open("Pictures to recolour to (folder)", "", partial(_recolor, session, captures.path))
    imgui.end_disabled()
    imgui.set_item_tooltip(
        "The same with pictures from a folder, such as transferred ones, named like the capture's own."
    )


def _recolor(session: Session, capture: Path, chosen: list[Path]) -> None:
    session.start_task(Recoloring(session.scene, session.files.known, capture, chosen[0]))


def _preset() -> None:
    plain_label("Settings", _PRESETS.get(_chosen.preset, ""))
    names = settings_names()
    changed, at = imgui.combo("##preset", names.index(_chosen.preset), names)
    imgui.set_item_tooltip(_PRESETS.get(_chosen.preset, ""))
    if changed:
        _chosen.preset, _chosen.settings = names[at], load_settings(names[at])


def _number(name: str, step: int) -> None:
    info = field_info(name, TrainingSettings)
    plain_label(f"{info.title} ({info.unit})" if info.unit else info.title, info.help)
    changed, value = imgui.input_int(f"##{name}", getattr(_chosen.settings, name), step, 10 * step)
    imgui.set_item_tooltip(info.help)
    if changed:
        _set(name, int(min(max(value, info.low), info.high)))


def _choice(name: str) -> None:
    info = field_info(name, TrainingSettings)
    plain_label(info.title, info.help)
    choices: list[Any] = list(info.choices) or list(range(int(info.low), int(info.high) + 1))
    changed, at = imgui.combo(
        f"##{name}", choices.index(getattr(_chosen.settings, name)), [str(each) for each in choices]
    )
    imgui.set_item_tooltip(info.help)
    if changed:
        _set(name, choices[at])


def _set(name: str, value: object) -> None:
    _chosen.settings = msgspec.structs.replace(_chosen.settings, **{name: value})
