"""Reconstruction of the open capture, recoloring from images, and training of the transfer."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.appearance.finetune.settings import finetuning_names
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.finetune import FinetuneChoice
from gsrain_engine.editor.jobs.training import HOW_TO_GET_TORCH, Losses, has_torch, recolor_job, reconstruction_job
from gsrain_engine.training.settings import TrainingSettings, load_settings, settings_names

from ..widgets.draw import line, plot
from ..widgets.fields import ALL_FILES, ask_what_to_open, edit_field, field_info, path_field, plain_label
from .jobs import job_fields
from .rain import WARNING


@dataclass(slots=True)
class _ReconstructionChoice:
    """Settings of the next reconstruction; they are not part of the document."""

    preset: str
    settings: TrainingSettings


_chosen = _ReconstructionChoice("laptop", load_settings("laptop"))

_PRESETS = {
    "draft": "A first look: two minutes on two processor cores.",
    "laptop": "Some ten minutes on two processor cores.",
    "full": "For a CUDA GPU with gsplat: 30,000 steps at full size.",
}

_NUMBERS = {"steps": 50, "width_px": 16, "gaussians": 5000, "held_out": 1}
"""Integer fields, each with the step of its buttons."""

_OWN_BODY: dict[str, bool | None] = {"automatic (drives only)": None, "look for it": True, "don't look": False}

_RECONSTRUCT_HELP = (
    "Fit Gaussians to the capture in the background. Snapshots come into the view meanwhile;\n"
    "undo brings the present scene back. A report shows the held-out views."
)

_RECOLOR_HELP = (
    "Solve for wet colours in which the present scene looks like the capture's pictures; its cameras\n"
    "must be in the scene's axes. The clear colours stay; one step, undo takes it back."
)

_RECOLOR_OTHERS_HELP = "The same with pictures from a folder, such as transferred ones, named like the capture's own."


def reconstruct_fields(session: Editor) -> None:
    captures = session.captures
    if captures.capture is None or captures.path is None:
        return
    if not captures.capture.has_poses:
        imgui.text_wrapped("Nothing tells where the cameras stood: let COLMAP find it, and open its folder.")
        return
    newest = session.newest_job("reconstruct", "recolor")
    if newest is not None and newest[1].state == "running":
        job_fields(session, newest[1], newest[0])
        return
    why_not = session.why_wait
    if has_torch():
        _settings()
        if _button("Reconstruct", _RECONSTRUCT_HELP, why_not):
            session.start(
                reconstruction_job(session, captures.path, _chosen.settings, allow_outside=captures.allows_outside)
            )
    else:
        imgui.text_wrapped(f"To reconstruct, torch is needed, which is not installed: {HOW_TO_GET_TORCH}")
    if not session.scene.gaussian_count:
        why_not = why_not or "There is no scene yet whose colours could be solved for."
    if _button("Recolour to these pictures", _RECOLOR_HELP, why_not):
        _recolor(session, captures.path, [])
    if _button("Recolour to other pictures...", _RECOLOR_OTHERS_HELP, why_not):
        ask_what_to_open("Pictures to recolour to (folder)", "", partial(_recolor, session, captures.path))
    if newest is not None:
        imgui.separator_text(newest[1].title)
        job_fields(session, newest[1], newest[0])


def _button(label: str, help_text: str, why_not: str | None) -> bool:
    imgui.begin_disabled(why_not is not None)
    is_pressed = imgui.button(label, (-1, 0))
    imgui.end_disabled()
    imgui.set_item_tooltip(help_text if why_not is None else why_not)
    return is_pressed


def _recolor(session: Editor, capture: Path, chosen: list[Path]) -> None:
    images, allowed = chosen[0] if chosen else None, session.captures.allows_outside
    session.start(recolor_job(session, session.files.known, capture, images, allow_outside=allowed))


def _settings() -> None:
    _preset()
    for name, step in _NUMBERS.items():
        _number(name, step)
    for name in ("density", "sh_degree"):
        _choice(name)
    _own_body()


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


def _own_body() -> None:
    info = field_info("own_body", TrainingSettings)
    plain_label(info.title, info.help)
    values = list(_OWN_BODY.values())
    changed, at = imgui.combo("##own_body", values.index(_chosen.settings.own_body), list(_OWN_BODY))
    imgui.set_item_tooltip(info.help)
    if changed:
        _set("own_body", values[at])


def _set(name: str, value: object) -> None:
    _chosen.settings = msgspec.structs.replace(_chosen.settings, **{name: value})


# Transfer training: settings, losses and samples

_FINETUNE_PRESETS = {
    "paper": "The paper's recipe: 20,000 iterations of 512 x 512; 16 hours on a data-centre GPU.",
    "tiny": "A trial of minutes on a processor, with a model too small to be of use.",
}

_CURVES = {
    "There and back": ("cycle_clear", "cycle_rainy", "identity_clear", "identity_rainy"),
    "Judges": ("gan_rainy", "gan_clear", "judge_rainy_made", "judge_rainy_real"),
}
"""Losses by plot: those to minimize, and the adversarial ones."""


def transfer_training_fields(session: Editor) -> None:
    studio = session.studio
    job = studio.job
    if job is None or job.state != "running":
        _choices(session)
        _start(session)
    if job is None or job not in session.jobs:
        return
    imgui.separator_text(job.title)
    job_fields(session, job, session.jobs.index(job))
    if job.progress.warning is not None:
        imgui.push_style_color(imgui.Col_.text, WARNING)
        imgui.text_wrapped(f"{icons_fontawesome_6.ICON_FA_TRIANGLE_EXCLAMATION}  {job.progress.warning}")
        imgui.pop_style_color()
    _curves(studio.losses)


def _choices(session: Editor) -> None:
    studio = session.studio
    _config(session)
    for name in ("clear", "rainy", "output"):
        path_field(studio.choice, name, "", partial(_take, session, name))
    studio.choice = edit_field(studio.choice, "steps", step=100)


def _config(session: Editor) -> None:
    choice = session.studio.choice
    names = [*finetuning_names(), "from a file..."]
    own = choice.config not in names
    shown = [Path(choice.config).name, *names] if own else names
    help_text = (
        choice.config if own else _FINETUNE_PRESETS.get(choice.config, field_info("config", FinetuneChoice).help)
    )
    plain_label("Settings", field_info("config", FinetuneChoice).help)
    changed, at = imgui.combo("##config", 0 if own else names.index(choice.config), shown)
    imgui.set_item_tooltip(help_text)
    if changed and shown[at] == names[-1]:
        ask_what_to_open("Settings of the training", f"YAML{{.yaml,.yml}},{ALL_FILES}", partial(_take_file, session))
    elif changed and shown[at] in names:
        session.studio.choice = msgspec.structs.replace(choice, config=shown[at])


def _take_file(session: Editor, chosen: list[Path]) -> None:
    session.studio.choice = msgspec.structs.replace(session.studio.choice, config=str(chosen[0]))


def _take(session: Editor, name: str, text: str) -> None:
    path = Path(text).expanduser() if text.strip() else None
    session.studio.choice = msgspec.structs.replace(session.studio.choice, **{name: path})


def _start(session: Editor) -> None:
    studio = session.studio
    why_not, can_resume = studio.why_not(session), studio.can_resume
    imgui.begin_disabled(why_not is not None)
    label = "Go on with the training" if can_resume else "Train the transfer"
    if imgui.button(f"{icons_fontawesome_6.ICON_FA_GRADUATION_CAP}  {label}###train", (-1, 0)):
        studio.start(session, resume=can_resume)
    imgui.end_disabled()
    help_text = (
        "Go on from the folder's checkpoint, as if it had never been stopped."
        if can_resume
        else "Fine-tune CycleGAN-Turbo on the two sets of pictures; Cancel keeps the last checkpoint."
    )
    imgui.set_item_tooltip(help_text if why_not is None else why_not)


def _curves(losses: Losses) -> None:
    if len(losses.get("step", ())) < 2:
        return
    for title, names in _CURVES.items():
        with plot(title, "iteration", "loss", legend=True) as seen:
            for name in names if seen else ():
                if name in losses:
                    line(name.replace("_", ", "), losses["step"], losses[name])
