"""`gsrain train-transfer CONFIG -o FOLDER`: fine-tune CycleGAN-Turbo from clear to rainy pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from gsrain_engine.appearance.finetuning.settings_file import finetuning_help, finetuning_names, load_finetuning
from gsrain_engine.appearance.finetuning.task import TrainingResult, TrainingTask
from gsrain_engine.session.appearance.transfer_training_work import train_transfer as work

from ..console import Console, Table, print
from .arguments import AllowOutside, JsonFile, let_names_lead_outside, write_numbers
from .outputs import check_writable, hold
from .progress import followed
from .trust import Trust, with_trust

_COLUMNS = 110


def train_transfer(
    config: Annotated[str, Parameter(help=f"YAML file, or shipped settings: {', '.join(finetuning_names())}.")],
    /,
    *,
    output: Annotated[
        Path, Parameter(name=["--output", "-o"], help="Folder for weights, checkpoint, losses, samples.")
    ],
    resume: Annotated[
        bool, Parameter(help="Go on from the checkpoint in FOLDER, as if it had never stopped.", negative="")
    ] = False,
    device: Annotated[Literal["auto", "cpu", "cuda"] | None, Parameter(help=finetuning_help("device"))] = None,
    steps: Annotated[int | None, Parameter(help=finetuning_help("steps"))] = None,
    clear: Annotated[
        list[Path] | None,
        Parameter(help="Captures or folders of clear pictures, in place of those of CONFIG.", negative=""),
    ] = None,
    rainy: Annotated[
        list[Path] | None,
        Parameter(help="Captures or folders of rainy pictures, in place of those of CONFIG.", negative=""),
    ] = None,
    base: Annotated[str | None, Parameter(help=finetuning_help("base"))] = None,
    clip: Annotated[str | None, Parameter(help=finetuning_help("clip"))] = None,
    lpips: Annotated[str | None, Parameter(help=finetuning_help("lpips"))] = None,
    start: Annotated[str | None, Parameter(help=finetuning_help("start"))] = None,
    seed: Annotated[int | None, Parameter(help=finetuning_help("seed"))] = None,
    trust: Trust = False,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Fine-tune the transfer on two sets of pictures that show no place twice. Ctrl-C leaves the last checkpoint."""
    let_names_lead_outside(allow_outside)
    changes = {"device": device, "steps": steps, "base": base, "clip": clip, "lpips": lpips, "start": start}
    changes |= {"seed": seed, "clear": _sources(clear), "rainy": _sources(rainy)}
    settings = with_trust(lambda: load_finetuning(config, **changes), trust)
    check_writable(json, folders=[output])
    hold(output)
    task = TrainingTask(settings=settings, output=output, resume=resume)
    try:
        result = followed(work(task))
    except KeyboardInterrupt:
        if task.checkpoint.is_file():
            print(f"stopped; go on with: gsrain train-transfer {task.config} -o {output} --resume")
        raise
    _print(result)
    guide = " --guide luma" if settings.pictures.guide == "luma" else ""
    print(f"to use it: gsrain transfer SCENE -o DIR --method cyclegan-turbo --weights {result.weights}{guide}")
    write_numbers(json, result.numbers)


def _sources(paths: Sequence[Path] | None) -> list[dict[str, Any]] | None:
    return None if paths is None else [{"path": str(path)} for path in paths]


def _print(result: TrainingResult) -> None:
    console = Console(width=_COLUMNS, highlight=False)
    pictures = Table("pictures", "look", "in all", "for testing", box=None)
    for path, look, count, tested in result.table:
        pictures.add_row(path, look, str(count), str(tested))
    console.print(pictures)
    losses = Table("loss", "mean of the last 100 iterations", box=None)
    for name, value in result.losses.items():
        losses.add_row(name.replace("_", ", "), f"{value:.4f}")
    console.print(losses)
    if not result.perceptual:
        console.print("Trained without LPIPS: its weights are missing, or its losses are set to 0.", markup=False)
    if result.warning is not None:
        console.print(f"WARNING: {result.warning}", markup=False)
    print(f"{result.weights}: {result.steps:,} iterations in {result.seconds:.0f} s")
    print(result.grid)
