"""`gsrain transfer` and `gsrain train-transfer`: rainy views from clear ones, and fine-tuning of the model."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from gsrain_engine.appearance.finetune.settings import (
    FinetuneResult,
    FinetuneTask,
    FinetuningSettings,
    ImageSettings,
    finetuning_names,
    load_finetuning,
)
from gsrain_engine.appearance.settings import TransferSettings
from gsrain_engine.appearance.view_choice import ViewChoice
from gsrain_engine.optional_packages import require_package
from gsrain_engine.rain.settings import HEAVIEST_MM_H
from gsrain_engine.safe_io.errors import MissingInputsError

from .console import Console, print, print_lines, run_with_progress
from .options import (
    AllowOutside,
    JsonFile,
    Trust,
    check_within,
    flag,
    let_names_lead_outside,
    named_options,
    option,
    options_of,
    takes_set,
    with_trust,
)
from .outputs import check_image, check_writable, claim_outputs, lock_outputs, write_numbers

ViewChoiceOptions = options_of(
    ViewChoice,
    "transfer",
    defaults={"count": "24, of a recording all", "width_px": "their own, at most 960"},
    topic="Views",
)


@Parameter(name="*")  # fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class MethodOptions(options_of(TransferSettings, "transfer", topic="Method")):
    """Transfer method and its settings."""

    method: Annotated[
        str,
        option(
            "wet: computed, no weights; cyclegan-turbo: the paper's model; images: --images; or one of an "
            "installed package.",
            topic="Method",
        ),
    ] = "wet"
    rain: Annotated[
        float | None,
        option("wet: wetness of steady rain of this intensity in mm/h.", "--rain", "--intensity", topic="Method"),
    ] = None
    no_normals: Annotated[bool, flag("cyclegan-turbo: same as --normals none.", "Method", rare=True)] = False

    def checked(self) -> TransferSettings:
        """Return the settings. Raises ValueError, which names the option, for invalid ones."""
        from gsrain_engine.rain.wetness import wetness

        values: dict[str, Any] = {}
        if self.no_normals:
            if self.normals not in (None, "depth", "none"):
                raise ValueError(f"--no-normals and --normals {self.normals} exclude each other")
            values["normals"] = "none"
        if self.rain is not None:
            if self.wetness is not None:
                raise ValueError("--rain and --wetness exclude each other")
            check_within("--rain", self.rain, 0, HEAVIEST_MM_H, "mm/h")
            values["wetness"] = wetness(self.rain)
        return self.settings(**values)

    def check(self, settings: TransferSettings, sources: Sequence[Path | str | None]) -> None:
        """Raise `MissingInputsError` early with all files, packages, scenes and captures that are missing."""
        from gsrain_engine.appearance.registry import find_method, missing_for_transfer
        from gsrain_engine.datasets.open_source import missing_source

        missing: list[str] = []
        try:
            if find_method(self.method).needs_torch:
                require_package("torch", f"--method {self.method}", "diffusion")
        except ValueError as error:
            missing.append(str(error))
        missing += missing_for_transfer(self.method, settings)
        missing += [line for source in sources for line in missing_source(source)]
        if missing:
            raise MissingInputsError(missing)


@takes_set
def transfer(
    source: Annotated[str, option("Scene file or folder, street (the built-in one), or a capture.")],
    /,
    *,
    output: Annotated[Path, option("Folder to write: a capture of rainy images.", "--output", "-o", topic="Output")],
    method: MethodOptions | None = None,
    views: ViewChoiceOptions | None = None,
    capture: Annotated[Path | None, option("Capture with the recorded cameras of a scene.", topic="Views")] = None,
    contact_sheet: Annotated[
        Path | None, option("Also write an image of some views before and after.", topic="Output")
    ] = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Make views rainy. gsrain recolor and gsrain reconstruct take DIR as --images.

    DIR/clear holds the original views: another program may change them, and --method images uses its results.
    """
    from gsrain_engine.appearance import output_folder
    from gsrain_engine.appearance.session import source_views, transfer_views
    from gsrain_engine.datasets.open_capture import open_capture
    from gsrain_engine.datasets.open_source import names_scene
    from gsrain_engine.render.images import write_image
    from gsrain_engine.scene.open import load_scene

    let_names_lead_outside(allow_outside)
    chosen = method or MethodOptions()
    settings, choice = chosen.checked(), (views or ViewChoiceOptions()).settings()
    check_image("--contact-sheet", contact_sheet)
    check_writable(contact_sheet, json, folders=[output])
    output_folder.check_transferred_folder(output)
    chosen.check(settings, (source, capture))
    lock_outputs(output)
    recording = None if capture is None else open_capture(capture)
    with named_options(ViewChoice, "capture"):
        views = source_views(load_scene(source) if names_scene(source) else open_capture(source), choice, recording)
    done = run_with_progress(transfer_views(views, chosen.method, settings, choice, output))
    for line in done.lines:
        print(line)
    if contact_sheet is not None:
        write_image(contact_sheet, done.figure)
        print(contact_sheet)
    write_numbers(json, done.numbers)


# gsrain train-transfer

_COLUMNS = 110

FinetuneOptions = options_of(FinetuningSettings, "train-transfer", "Default: what CONFIG says.", topic="Training")
ImageOptions = options_of(ImageSettings, "train-transfer", "Default: what CONFIG says.", topic="Views")


@takes_set
def train_transfer(
    config: Annotated[str, option(f"YAML file, or shipped settings: {', '.join(finetuning_names())}.")],
    /,
    *,
    output: Annotated[
        Path, option("Folder for weights, checkpoint, losses, samples.", "--output", "-o", topic="Output")
    ],
    resume: Annotated[bool, flag("Continue from the checkpoint in FOLDER.", "Training")] = False,
    options: FinetuneOptions | None = None,
    images: ImageOptions | None = None,
    trust: Trust = False,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Fine-tune the transfer on two unpaired sets of images. Ctrl-C leaves the last checkpoint.

    Weights, programs and images that are missing are all named before any work.
    """
    from gsrain_engine.editor.finetune import train_transfer as work

    let_names_lead_outside(allow_outside)
    changes = (options or FinetuneOptions()).changes() | (images or ImageOptions()).changes()
    settings = with_trust(lambda: load_finetuning(config, **changes), trust)
    claim_outputs(json, folders=[output])
    task = FinetuneTask(settings=settings, output=output, resume=resume)
    try:
        result = run_with_progress(work(task))
    except KeyboardInterrupt:
        if task.checkpoint.is_file():
            print(f"stopped; go on with: gsrain train-transfer {task.config} -o {output} --resume")
        raise
    _print(result)
    pictures = settings.pictures
    needed = {"normals-weights": pictures.normals_weights, "normals-checkout": pictures.normals_checkout}
    words = "".join(f" --{name} {path}" for name, path in needed.items() if path and pictures.guide != "none")
    print(f"to use it: gsrain transfer SCENE -o DIR --method cyclegan-turbo --weights {result.weights}{words}")
    write_numbers(json, result.numbers)


def _print(result: FinetuneResult) -> None:
    from gsrain_engine.report.table import Table, columns

    console = Console(width=_COLUMNS, highlight=False)
    images = Table("Pictures", columns(("pictures", "look", "in all", "for testing")), result.table)
    named = [(name.replace("_", ", "), value) for name, value in result.losses.items()]
    losses = Table("Losses", columns({"loss": "", "mean of the last 100 iterations": ".4f"}), named)
    for table in (images, losses):
        print_lines(f"{table.text}\n")
    if not result.perceptual:
        console.print("Trained without LPIPS: its weights are missing, or its losses are set to 0.")
    if result.warning is not None:
        console.print(f"WARNING: {result.warning}")
    print(f"{result.weights}: {result.steps:,} iterations in {result.seconds:.0f} s")
    print(result.grid)
