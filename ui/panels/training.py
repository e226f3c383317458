"""Reconstruction of the open capture, recoloring from images, and training of the transfer."""

from functools import partial
from pathlib import Path

import msgspec
from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.appearance.finetune.settings import finetuning_names
from gsrain_engine.editor.capture_view import CaptureController
from gsrain_engine.editor.finetune import FinetuneChoice, FinetuneController
from gsrain_engine.editor.jobs.job import JobRunner
from gsrain_engine.editor.training import TrainingController
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.fields import field_of
from gsrain_engine.optional_packages import has_package, missing_package
from gsrain_engine.training.settings import TrainingSettings, settings_names

from ..widgets.fields import button, combo, edit_choice, edit_field, plain_label
from ..widgets.file_dialogs import ALL_FILES, ask_what_to_open, path_field
from .jobs import job_fields

_PRESETS = {
    "draft": "A first look: two minutes on two processor cores.",
    "laptop": "About ten minutes on two processor cores.",
    "full": "For a CUDA GPU with gsplat: 30,000 steps at full size.",
}
_STEPS = {"steps": 50, "width_px": 16, "gaussians": 5000, "held_out": 1}
"""Integer fields, each with the step of its buttons."""

_OWN_BODY = {None: "automatic (drives only)", True: "search", False: "no search"}
_RECONSTRUCT_HELP = (
    "Fit Gaussians to the capture in the background. The viewport shows snapshots meanwhile;\n"
    "undo restores the present scene. A report shows the held-out views."
)
_RECOLOR_HELP = (
    "Solve for wet colors of the present scene that reproduce the capture's images; its cameras\n"
    "must be in the scene's axes. The clear colors stay. One undo step."
)
_RECOLOR_OTHERS_HELP = "The same with images from a folder, such as transferred ones, named like the capture's own."


def reconstruct_fields(
    viewport: ViewportState, captures: CaptureController, training: TrainingController, jobs: JobRunner
) -> None:
    if captures.capture is None:
        return
    if not captures.capture.has_poses:
        imgui.text_wrapped("The camera poses are unknown: compute them with COLMAP, and open its folder.")
        return
    if has_package("torch"):
        _reconstruction_settings(training)
        if button("Reconstruct", _RECONSTRUCT_HELP, width=-1):
            training.reconstruct()
    else:
        imgui.text_wrapped(missing_package("torch", "Reconstruction"))
    why_not = training.why_no_recoloring
    if button("Recolor to these images", _RECOLOR_HELP, width=-1, why_not=why_not):
        training.recolor()
    if button("Recolor to other images...", _RECOLOR_OTHERS_HELP, width=-1, why_not=why_not):
        ask_what_to_open("Images to recolor to (folder)", "", lambda chosen: training.recolor(chosen[0]))
    if (newest := jobs.newest("reconstruct", "recolor")) is not None:
        imgui.separator_text(newest.title)
        job_fields(viewport, jobs, newest)


def _reconstruction_settings(training: TrainingController) -> None:
    help_text = _PRESETS.get(training.preset, "")
    plain_label("Settings", help_text)
    if (preset := combo("##preset", training.preset, settings_names(), help_text)) != training.preset:
        training.choose_preset(preset)
    settings, info = training.settings, field_of(TrainingSettings, "sh_degree")
    for name, step in _STEPS.items():
        settings = edit_field(settings, name, step=step)
    settings = edit_field(settings, "density")
    settings = edit_choice(settings, "sh_degree", range(int(info.low), int(info.high) + 1))
    training.settings = edit_choice(settings, "own_body", _OWN_BODY)


# Transfer training: settings

_FINETUNE_PRESETS = {
    "paper": "The paper's recipe: 20,000 iterations of 512 x 512; 16 hours on a data-center GPU.",
    "tiny": "A trial of minutes on a CPU, with a model too small for real use.",
}


def transfer_training_fields(viewport: ViewportState, finetune: FinetuneController, jobs: JobRunner) -> None:
    job = finetune.job
    _config(finetune)
    for name in ("clear", "rainy", "output"):
        path_field(finetune.choice, name, "", partial(_take, finetune, name))
    finetune.choice = edit_field(finetune.choice, "steps", step=100)
    can_resume, why_not = finetune.can_resume, finetune.why_not
    title = "Resume training" if can_resume else "Train transfer"
    help_text = "Continue from the folder's checkpoint, with the same result as without a stop."
    if not can_resume:
        help_text = "Fine-tune CycleGAN-Turbo on the two sets of images; Cancel preserves the last checkpoint."
    title = f"{icons_fontawesome_6.ICON_FA_GRADUATION_CAP}  {title}###train"
    if button(title, help_text, width=-1, why_not=why_not):
        finetune.start(resume=can_resume)
    if job is not None and job in jobs.all:
        imgui.separator_text(job.title)
        job_fields(viewport, jobs, job)


def _config(finetune: FinetuneController) -> None:
    choice, from_file = finetune.choice, "from a file..."
    names, help_text = finetuning_names(), field_of(FinetuneChoice, "config").help
    choices = {each: each for each in names} | {from_file: from_file}
    if choice.config not in names:
        choices, help_text = {choice.config: Path(choice.config).name} | choices, choice.config
    plain_label("Settings", field_of(FinetuneChoice, "config").help)
    picked = combo("##config", choice.config, choices, _FINETUNE_PRESETS.get(choice.config, help_text))
    if picked == from_file:
        ask_what_to_open("Settings of the training", f"YAML{{.yaml,.yml}},{ALL_FILES}", partial(_take_file, finetune))
    elif picked != choice.config:
        finetune.choice = msgspec.structs.replace(choice, config=picked)


def _take_file(finetune: FinetuneController, chosen: list[Path]) -> None:
    finetune.choice = msgspec.structs.replace(finetune.choice, config=str(chosen[0]))


def _take(finetune: FinetuneController, name: str, path: Path | None) -> None:
    finetune.choice = msgspec.structs.replace(finetune.choice, **{name: path})
