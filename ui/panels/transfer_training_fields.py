"""Train the transfer: settings, pictures and folder; while it learns its losses as curves, and samples."""

from functools import partial
from pathlib import Path

import msgspec
from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.appearance.finetuning.settings_file import finetuning_names
from gsrain_engine.session.appearance.transfer_studio import TrainingChoice
from gsrain_engine.session.appearance.transfer_training import Losses
from gsrain_engine.session.session import Session

from ..widgets.fields import field_info, plain_label
from ..widgets.file_dialogs import ask_what_to_open
from ..widgets.plots import line, plot
from ..widgets.struct_fields import ALL_FILES, edited, place
from .job_fields import job_fields
from .rain_panel import WARNING

_PRESETS = {
    "paper": "The paper's recipe: 20,000 iterations of 512 x 512; 16 hours on a data-centre GPU.",
    "tiny": "A trial of minutes on a processor, with a model too small to be of use.",
}
_CURVES = {
    "There and back": ("cycle_clear", "cycle_rainy", "identity_clear", "identity_rainy"),
    "Judges": ("gan_rainy", "gan_clear", "judge_rainy_made", "judge_rainy_real"),
}
"""Losses by plot: what shall fall, and what shall hold each other in balance."""


def transfer_training_fields(session: Session) -> None:
    studio = session.studio
    job = studio.job
    if job is None or job.state != "running":
        _choices(session)
        _start(session)
    if job is None or job not in session.jobs:
        return
    imgui.separator_text(job.title)
    job_fields(session, job, session.jobs.index(job))
    if job.warning is not None:
        imgui.push_style_color(imgui.Col_.text, WARNING)
        imgui.text_wrapped(f"{icons_fontawesome_6.ICON_FA_TRIANGLE_EXCLAMATION}  {job.warning}")
        imgui.pop_style_color()
    _curves(job.losses)


def _choices(session: Session) -> None:
    studio = session.studio
    _config(session)
    for name in ("clear", "rainy", "output"):
        place(studio.choice, name, "", partial(_take, session, name))
    studio.choice = edited(studio.choice, "steps", step=100)


def _config(session: Session) -> None:
    choice = session.studio.choice
    names = [*finetuning_names(), "from a file..."]
    own = choice.config not in names
    shown = [Path(choice.config).name, *names] if own else names
    help_text = choice.config if own else _PRESETS.get(choice.config, field_info("config", TrainingChoice).help)
    plain_label("Settings", field_info("config", TrainingChoice).help)
    changed, at = imgui.combo("##config", 0 if own else names.index(choice.config), shown)
    imgui.set_item_tooltip(help_text)
    if changed and shown[at] == names[-1]:
        ask_what_to_open("Settings of the training", f"YAML{{.yaml,.yml}},{ALL_FILES}", partial(_take_file, session))
    elif changed and shown[at] in names:
        session.studio.choice = msgspec.structs.replace(choice, config=shown[at])


def _take_file(session: Session, chosen: list[Path]) -> None:
    session.studio.choice = msgspec.structs.replace(session.studio.choice, config=str(chosen[0]))


def _take(session: Session, name: str, text: str) -> None:
    path = Path(text).expanduser() if text.strip() else None
    session.studio.choice = msgspec.structs.replace(session.studio.choice, **{name: path})


def _start(session: Session) -> None:
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
