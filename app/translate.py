"""`gsrain transfer` and `gsrain train-transfer`: rainy views from clear ones, and fine-tuning of the model."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from cyclopts import Parameter
from jaxtyping import Bool, Float64

from gsrain_engine.appearance import output_folder
from gsrain_engine.appearance.base import (
    ClearView,
    NetworkTransfer,
    RainyView,
    SkippedCounts,
    TransferSettings,
)
from gsrain_engine.appearance.capture_views import CaptureViews
from gsrain_engine.appearance.finetune.dataset import ImageSettings
from gsrain_engine.appearance.finetune.settings import (
    FinetuneResult,
    FinetuneTask,
    FinetuningSettings,
    finetuning_names,
    load_finetuning,
)
from gsrain_engine.appearance.registry import find_method, missing_for_transfer, open_transfer
from gsrain_engine.appearance.scene_views import OWN_WIDTH_PX, ViewChoice, chosen_cameras, chosen_views, scene_views
from gsrain_engine.appearance.wet_look.environment import ImageEnvironment, ReflectionEnvironment, SceneEnvironment
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.editor.finetune import train_transfer as work
from gsrain_engine.editor.jobs.training import HOW_TO_GET_DIFFUSION, require_torch
from gsrain_engine.rain.settings import HEAVIEST_MM_H
from gsrain_engine.rain.wetness import wetness
from gsrain_engine.render.images import write_image
from gsrain_engine.safe_io.errors import MissingInputsError
from gsrain_engine.scene.open import load_scene

from .console import Console, Table, print, progress_bar, run_with_progress
from .options import (
    AllowOutside,
    JsonFile,
    Trust,
    check_within,
    flag,
    let_names_lead_outside,
    option,
    options_of,
    with_trust,
)
from .outputs import check_image, check_writable, claim_outputs, lock_outputs, write_numbers
from .scene import missing_source, names_scene

ViewChoiceOptions = options_of(
    ViewChoice, "transfer", defaults={"count": "24, of a recording all", "width_px": "their own, at most 960"}
)


@Parameter(name="*")  # fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class MethodOptions(options_of(TransferSettings, "transfer")):
    """Transfer method and its settings."""

    method: Annotated[
        str,
        option(
            "wet: computed, no weights; cyclegan-turbo: the paper's model; images: --images; or one of an "
            "installed package."
        ),
    ] = "wet"
    rain: Annotated[
        float | None, option("wet: wetness of steady rain of this intensity in mm/h.", "--rain", "--intensity")
    ] = None
    no_normals: Annotated[bool, flag("cyclegan-turbo: same as --normals none.")] = False

    def checked(self) -> TransferSettings:
        """Return the settings. Raises ValueError, which names the option, for invalid ones."""
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
        missing: list[str] = []
        try:
            if find_method(self.method).needs_torch:
                require_torch(f"--method {self.method}", HOW_TO_GET_DIFFUSION)
        except ValueError as error:
            missing.append(str(error))
        missing += missing_for_transfer(self.method, settings)
        missing += [line for source in sources for line in missing_source(source)]
        if missing:
            raise MissingInputsError(missing)


def transfer(
    source: Annotated[str, option("Scene file or folder, street (the built-in one), or a capture.")],
    /,
    *,
    output: Annotated[Path, option("Folder to write: a capture of rainy images.", "--output", "-o")],
    method: MethodOptions | None = None,
    views: ViewChoiceOptions | None = None,
    capture: Annotated[Path | None, option("Capture with the recorded cameras of a scene.")] = None,
    contact_sheet: Annotated[Path | None, option("Also write an image of some views before and after.")] = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Make views rainy. gsrain recolor and gsrain reconstruct take DIR as --images.

    DIR/clear holds the original views: another program may change them, and --method images uses its results.
    """
    let_names_lead_outside(allow_outside)
    chosen = method or MethodOptions()
    settings, choice = chosen.checked(), (views or ViewChoiceOptions()).settings()
    check_image("--contact-sheet", contact_sheet)
    check_writable(contact_sheet, json, folders=[output])
    output_folder.check_transferred_folder(output)
    chosen.check(settings, (source, capture))
    lock_outputs(output)
    opened = source_views(source, choice, capture)
    model = open_transfer(chosen.method, settings, opened.surroundings)
    values = msgspec.to_builtins(settings, enc_hook=str) | msgspec.to_builtins(choice) | {"width_px": opened.width_px}
    network = model.network_input(opened.views[0]) if isinstance(model, NetworkTransfer) else None
    framing: dict[str, Any] = {} if network is None else msgspec.to_builtins(network)
    values |= framing
    record = output_folder.TransferRecord(chosen.method, opened.name, values, opened.to_world)
    rainy = output_folder.write_transferred(output, model.transferred(opened.views), record, opened.mask)
    numbers = {"method": chosen.method, "width_px": opened.width_px, **framing}
    numbers |= _write_views(rainy, len(opened.views), contact_sheet)
    for note in numbers["notes"]:
        print(note)
    made = f"{numbers['views']} rainy views of {opened.name}"
    if network is not None:
        print(network.words)
    print(f"{output}: {made}, {opened.width_px} px wide, in {numbers['seconds']:.1f} s")
    if contact_sheet is not None:
        print(contact_sheet)
    write_numbers(json, numbers)


def _write_views(rainy: Iterator[RainyView], count: int, sheet: Path | None) -> dict[str, Any]:
    """Make the views with a progress bar; returns the numbers of `--json`."""
    started, films, pictures = time.perf_counter(), list[float](), output_folder.ContactSheet(count)
    made, left_out = 0, SkippedCounts()
    with progress_bar("Rainy views", count) as advance:
        for view in rainy:
            made += 1
            left_out.add(view)
            if view.film is not None:
                films.append(float(view.film.mean()))
            if sheet is not None:
                pictures.add(view)
            advance()
    seconds = time.perf_counter() - started
    if sheet is not None:
        write_image(sheet, pictures.picture())
    return {
        "views": made,
        "seconds": round(seconds, 3),
        "seconds_per_view": round(seconds / max(made, 1), 3),
        "film_share_mean": round(float(np.mean(films)), 5) if films else None,
        "notes": list(left_out.sentences),
    }


# Source views


@dataclass(frozen=True, slots=True, eq=False)
class SourceViews:
    """Views in the world, computed on demand, and their surroundings."""

    name: str
    views: Sequence[ClearView]
    surroundings: ReflectionEnvironment
    to_world: Float64[np.ndarray, "4 4"]
    """Similarity from the units and axes of the scene or capture to the world."""
    width_px: int
    """Width of the widest image."""
    mask: Callable[[str], Bool[np.ndarray, "h w"] | None]
    """Mask of pixels to learn from, by view name; None means all."""


def source_views(source: str, choice: ViewChoice, capture: Path | None) -> SourceViews:
    """Open a scene or a capture; `capture` provides a scene's recorded cameras.

    Raises ValueError, which names the option, if the choice doesn't fit.
    """
    if names_scene(source):
        if choice.source == "recorded" and capture is None:
            raise ValueError("--views recorded needs --capture, where the cameras come from")
        scene = load_scene(source)
        placed = chosen_cameras(scene, choice, None if capture is None else open_capture(capture), OWN_WIDTH_PX)
        views, around = scene_views(scene, placed), SceneEnvironment(scene)
        width_px = max(each.camera.width for each in placed)
        return SourceViews(scene.name, views, around, scene.scene_to_world, width_px, lambda name: None)
    if choice.source not in ("auto", "recorded"):
        raise ValueError(f"--views {choice.source}: {source} is a capture, whose views are those of its pictures")
    if capture is not None:
        raise ValueError(f"--capture: {source} is a capture itself")
    max_px = choice.width_px or OWN_WIDTH_PX
    opened = chosen_views(open_capture(Path(source)), choice)
    views, width_px = CaptureViews(opened, max_px), max(min(max_px, view.camera.width) for view in opened)
    return SourceViews(opened.name, views, ImageEnvironment(), views.to_world, width_px, views.mask)


# gsrain train-transfer

_COLUMNS = 110

FinetuneOptions = options_of(FinetuningSettings, "train-transfer", "Default: what CONFIG says.")
ImageOptions = options_of(ImageSettings, "train-transfer", "Default: what CONFIG says.")


def train_transfer(
    config: Annotated[str, option(f"YAML file, or shipped settings: {', '.join(finetuning_names())}.")],
    /,
    *,
    output: Annotated[Path, option("Folder for weights, checkpoint, losses, samples.", "--output", "-o")],
    resume: Annotated[bool, flag("Continue from the checkpoint in FOLDER.")] = False,
    options: FinetuneOptions | None = None,
    images: ImageOptions | None = None,
    trust: Trust = False,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Fine-tune the transfer on two unpaired sets of images. Ctrl-C leaves the last checkpoint.

    Weights, programs and images that are missing are all named before any work.
    """
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
    console = Console(width=_COLUMNS, highlight=False)
    images = Table("pictures", "look", "in all", "for testing", box=None)
    for row in result.table:
        images.add_row(*map(str, row))
    console.print(images)
    losses = Table("loss", "mean of the last 100 iterations", box=None)
    for name, value in result.losses.items():
        losses.add_row(name.replace("_", ", "), f"{value:.4f}")
    console.print(losses)
    if not result.perceptual:
        console.print("Trained without LPIPS: its weights are missing, or its losses are set to 0.")
    if result.warning is not None:
        console.print(f"WARNING: {result.warning}")
    print(f"{result.weights}: {result.steps:,} iterations in {result.seconds:.0f} s")
    print(result.grid)
