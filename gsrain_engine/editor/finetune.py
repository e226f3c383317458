"""Fine-tuning of the transfer: setup in the window, job, and worker, with LPIPS if weights are available."""

from collections.abc import Generator
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from ..appearance.cyclegan_turbo.weight_paths import find_whole_base_model
from ..appearance.finetune.settings import (
    FinetuneResult,
    FinetuneTask,
    FinetuningSettings,
    code_of,
    find_clip,
    load_finetuning,
)
from ..appearance.normals import ESTIMATORS, missing_estimator_files
from ..evaluation.lpips_weights import find_lpips_weights
from ..optional_packages import has_package, missing_package, require_package
from ..safe_io.errors import MissingInputsError, not_found
from ..safe_io.text_files import printable_line
from ..scene.progress import Progress
from ..settings import Settings
from ..trusted_code import UntrustedCodeError, expect_trusted, trust_permanently
from .jobs.job import Job, JobRunner
from .status import Answer, Question, StatusBus


class FinetuneChoice(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The user's choices; everything else comes from the settings file."""

    config: Annotated[str, Meta(title="Settings", description="Shipped settings, or a YAML file of the same form.")] = (
        "tiny"
    )
    clear: Annotated[
        Path | None,
        Meta(title="Clear pictures", description="Folder or capture; without one, as in the settings."),
    ] = None
    rainy: Annotated[
        Path | None,
        Meta(
            title="Rainy pictures",
            description="Folder or capture, of other places; without one, as in the settings.",
        ),
    ] = None
    output: Annotated[
        Path | None, Meta(title="Output", description="Folder for weights, checkpoint, losses and sample pictures.")
    ] = None
    steps: Annotated[
        int, Meta(ge=0, le=10_000_000, title="Steps", description="Iterations; 0: as many as the settings say.")
    ] = 0


class FinetuneController:
    """One training at a time. Main thread only."""

    def __init__(self, jobs: JobRunner, status: StatusBus) -> None:
        """Start with the shipped trial settings."""
        self._jobs, self._status = jobs, status
        self.choice = FinetuneChoice()
        self.job: Job[Path] | None = None

    @property
    def can_resume(self) -> bool:
        """True if the folder holds a checkpoint of a stopped training."""
        return self.choice.output is not None and (self.choice.output / "checkpoint.safetensors").is_file()

    @property
    def why_not(self) -> str | None:
        """Reason why no training can start now, in one sentence, or None."""
        if not has_package("torch"):
            return missing_package("torch", "Training", "diffusion")
        if self.choice.output is None:
            return "Choose the output folder for the weights first."
        for path in (self.choice.clear, self.choice.rainy):
            if path is not None and not path.exists():
                return f"{path}: is not there; choose other pictures."
        if (job := self._jobs.writes(self.choice.output)) is not None:
            return f"{job.title} works in this folder already: wait for it, cancel it, or choose another one."
        return None

    def start(self, *, resume: bool = False) -> None:
        """Start, or resume from the folder's checkpoint; errors in the settings are reported."""
        if self.why_not is not None:
            return
        choice, output = self.choice, self.choice.output
        assert output is not None, "asked for before"
        changes: dict[str, Any] = {"steps": choice.steps or None}
        for look, path in (("clear", choice.clear), ("rainy", choice.rainy)):
            changes[look] = None if path is None else [{"path": str(path)}]
        try:
            settings = load_finetuning(choice.config, **changes)
            task = FinetuneTask(settings=settings, output=output, resume=resume, code=code_of(settings))
        except UntrustedCodeError as error:
            self._ask(error, resume)
            return
        except (ValueError, OSError) as error:
            self._status.report(str(error))
            return
        self.job = self._jobs.start(finetune_job(task), lambda weights, _: f"Trained: {weights}")

    def _ask(self, error: UntrustedCodeError, resume: bool) -> None:
        """Ask before running Python code that the settings name; on yes, trust its content permanently and start."""

        def run() -> None:
            trust_permanently(error.codes)
            self.start(resume=resume)

        listed = "\n".join(f"{printable_line(each.path)}\nSHA-256 {each.digest}" for each in error.codes)
        text = f"{printable_line(error.named_by)} names Python code, which would run with all your rights:\n\n{listed}"
        no = Answer("Don't run it", help="Nothing is begun.")
        yes = Answer("Run it", run, "Runs it now, and does not ask again for these very contents.")
        self._status.ask(Question("Run Python code?", text, (no, yes, Answer("Cancel"))))


# Job "Train transfer"

_LOSS_PLOTS = {
    "Cycle": ("cycle_clear", "cycle_rainy", "identity_clear", "identity_rainy"),
    "Discriminators": ("gan_rainy", "gan_clear", "judge_rainy_made", "judge_rainy_real"),
}
"""Losses by plot: those to minimize, and the adversarial ones."""


def finetune_job(task: FinetuneTask) -> Job[Path]:
    """Create a job whose result is the file of the weights. After cancelling, a job can resume from its folder."""
    return Job(
        "fine-tune", "Train transfer", train_transfer, lambda _: task.weights, lambda _: (task,),
        ends_with_scene=False, output=task.output, progress=Progress(0.0, "Starting"), plots=_LOSS_PLOTS,
    )  # fmt: skip


def missing_for_finetuning(settings: FinetuningSettings) -> list[str]:
    """Name every file and folder that a fine-tuning lacks, with how to get it; a line each.

    LPIPS counts only with others: without its weights a fine-tuning goes on, with a warning.
    """
    pictures, missing = settings.pictures, list[str]()
    for look, sources in (("clear", pictures.clear), ("rainy", pictures.rainy)):
        paths = [each.path for each in sources if not Path(each.path).exists()]
        missing += [f"{path}: no such file or folder; --{look} PATH names {look} pictures" for path in paths]
    missing += [
        f"--{name} {path}: no such file or folder"
        for name, path in (("start", settings.start), ("lpips", settings.lpips))
        if path is not None and not Path(path).exists()
    ]
    if pictures.guide != "none" and pictures.normals in ESTIMATORS:
        missing += missing_estimator_files(pictures.normals, pictures.normals_weights, pictures.normals_checkout)
    is_tiny, base, clip = settings.architecture == "tiny", settings.base, settings.clip
    if not is_tiny:
        missing += not_found(find_whole_base_model, None if base is None else Path(base))
    if not is_tiny or clip is not None:
        missing += not_found(find_clip, None if clip is None else Path(clip))
    if missing and settings.lpips is None and _uses_lpips(settings):
        missing += not_found(find_lpips_weights, "vgg")
    return missing


def _uses_lpips(settings: FinetuningSettings) -> bool:
    return bool(settings.losses.cycle_lpips or settings.losses.identity_lpips)


def train_transfer(task: FinetuneTask) -> Generator[Progress, None, FinetuneResult]:
    """Fine-tune.

    Yields and raises as `finetune` does, ValueError if torch is missing, and `MissingInputsError` for missing files.
    """
    require_package("torch", "training the transfer", "diffusion")
    expect_trusted(task.code)
    if missing := missing_for_finetuning(task.settings):
        raise MissingInputsError(missing)
    from ..appearance.finetune.run import chosen_device, finetune
    from ..evaluation.lpips import lpips_loss

    settings = task.settings
    file = None if settings.lpips is None else Path(settings.lpips)
    lpips = lpips_loss(file, chosen_device(settings.device)) if _uses_lpips(settings) else None
    return (yield from finetune(task, lpips))
