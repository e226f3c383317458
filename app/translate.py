"""`gsrain transfer` and `gsrain train-transfer`: rainy views from clear ones, and fine-tuning of the model."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from cyclopts import Parameter
from jaxtyping import Bool, Float64

from gsrain_engine.appearance.base import ClearView, RainyView, SkippedCounts, TransferSettings
from gsrain_engine.appearance.finetune.settings import (
    FinetuneResult,
    FinetuneTask,
    finetuning_help,
    finetuning_names,
    load_finetuning,
)
from gsrain_engine.appearance.output_folder import (
    ContactSheet,
    TransferRecord,
    check_transferred_folder,
    write_transferred,
)
from gsrain_engine.appearance.registry import find_method, open_transfer
from gsrain_engine.appearance.scene_views import OWN_WIDTH_PX, Source, ViewChoice, chosen_cameras, chosen_views
from gsrain_engine.appearance.wet_look.environment import ReflectionEnvironment
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.editor.jobs.training import HOW_TO_GET_DIFFUSION, require_torch
from gsrain_engine.editor.jobs.training import train_transfer as work
from gsrain_engine.rain.wetness import wetness
from gsrain_engine.render.images import write_image
from gsrain_engine.scene.open import load_scene

from .console import Console, Table, print
from .options import (
    AllowOutside,
    JsonFile,
    Trust,
    check_image,
    check_writable,
    converted_options,
    let_names_lead_outside,
    lock_outputs,
    with_trust,
    write_numbers,
)
from .progress import followed, progress_bar
from .scene_options import names_scene

# Options of gsrain transfer


@Parameter(name="*")  # fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class ViewChoiceOptions:
    """Choice of views."""

    views: Annotated[
        Source,
        Parameter(help="Of a scene: recorded (see --capture), rig (along the ego's way), path, around; auto chooses."),
    ] = "auto"
    capture: Annotated[Path | None, Parameter(help="Where a scene's recorded cameras come from.")] = None
    count: Annotated[int | None, Parameter(help="Number of views, evenly; default: 24, of a recording all.")] = None
    cameras: Annotated[str, Parameter(help="Only these cameras of the rig or recording, commas between.")] = ""
    width: Annotated[
        int | None,
        Parameter(help="Width of pictures in px; a capture's are never enlarged. Default: their own, at most 960."),
    ] = None

    @property
    def choice(self) -> ViewChoice:
        """Return the options as a value. Raises ValueError, which names the option, if one is out of bounds."""
        sensors = tuple(name.strip() for name in self.cameras.split(",") if name.strip())
        return converted_options(
            {"source": self.views, "count": self.count, "width_px": self.width, "sensors": sensors},
            ViewChoice,
            _OPTIONS,
        )


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class MethodOptions:
    """Transfer method and its settings."""

    method: Annotated[
        str,
        Parameter(
            help="wet: computed, no weights; cyclegan-turbo: the paper's model; images: --images; or a package's."
        ),
    ] = "wet"
    rain: Annotated[float | None, Parameter(help="wet: as wet as steady rain of so many mm/h makes things.")] = None
    wetness: Annotated[
        float | None, Parameter(help="wet: 0 dry, 1 soaked; default 1, which gsrain recolor makes wet colours of.")
    ] = None
    seed: Annotated[int, Parameter(help="wet: chooses where puddles stand, and clouds.")] = 0
    images: Annotated[
        Path | None, Parameter(help="images: folder with pictures, matched by name: SENSOR/NAME or NAME.")
    ] = None
    weights: Annotated[
        Path | None, Parameter(help="cyclegan-turbo: file with its weights, else see gsrain doctor.")
    ] = None
    base: Annotated[Path | None, Parameter(help="cyclegan-turbo: SD-Turbo's folder, else see gsrain doctor.")] = None
    normals: Annotated[
        Literal["depth", "dsine", "marigold", "none"], Parameter(help="cyclegan-turbo: who tells surface normals.")
    ] = "depth"
    no_normals: Annotated[bool, Parameter(help="cyclegan-turbo: as --normals none.", negative="")] = False
    normals_weights: Annotated[Path | None, Parameter(help="File of DSINE, or folder of Marigold.")] = None
    normals_checkout: Annotated[Path | None, Parameter(help="Your own copy of DSINE's program.")] = None
    guide: Annotated[
        Literal["up", "luma"], Parameter(help="cyclegan-turbo: how normals become one channel; luma as in the paper.")
    ] = "up"
    mutual_attention: Annotated[
        bool, Parameter(help="cyclegan-turbo: whether each view attends to its neighbours.")
    ] = True
    neighbours: Annotated[int, Parameter(help="cyclegan-turbo: to how many.")] = 2
    side: Annotated[int, Parameter(help="cyclegan-turbo: shorter side in px of what it sees.")] = 512
    tile: Annotated[int | None, Parameter(help="cyclegan-turbo: side in px of tiles; default: in one piece.")] = None
    device: Annotated[Literal["auto", "cpu", "cuda"], Parameter(help="cyclegan-turbo: where it runs.")] = "auto"
    precision: Annotated[
        Literal["float32", "float16", "bfloat16"],
        Parameter(help="cyclegan-turbo: of its numbers; bfloat16 blurs what one step amplifies."),
    ] = "float32"

    @property
    def settings(self) -> TransferSettings:
        """Return the options as a value. Raises ValueError, which names the option, for invalid ones."""
        if self.no_normals and self.normals not in ("depth", "none"):
            raise ValueError(f"--no-normals and --normals {self.normals} exclude each other")
        return converted_options(
            {
                "wetness": self._wetness(), "seed": self.seed, "images": self.images, "weights": self.weights,
                "base": self.base, "normals": "none" if self.no_normals else self.normals,
                "normals_weights": self.normals_weights, "normals_checkout": self.normals_checkout,
                "guide": self.guide, "mutual_attention": self.mutual_attention, "neighbours": self.neighbours,
                "side_px": self.side, "tile_px": self.tile, "device": self.device, "precision": self.precision,
            }, TransferSettings, _OPTIONS,
        )  # fmt: skip

    def check(self) -> None:
        """Raise ValueError early if a file or torch is missing."""
        method = find_method(self.method)
        if method.needs is not None and getattr(self, method.needs) is None:
            raise ValueError(f"--method {self.method} needs --{method.needs}")
        for name in ("weights", "base", "images", "normals_weights", "normals_checkout"):
            path: Path | None = getattr(self, name)
            if path is not None and not path.exists():
                raise ValueError(f"--{name.replace('_', '-')} {path}: no such file or folder")
        if method.needs_torch:
            require_torch(f"--method {self.method}", HOW_TO_GET_DIFFUSION)

    def _wetness(self) -> float:
        if self.rain is None:
            return 1.0 if self.wetness is None else self.wetness
        if self.wetness is not None:
            raise ValueError("--rain and --wetness exclude each other")
        if not 0 <= self.rain <= _MAX_MM_H:
            raise ValueError(f"--rain {self.rain:g}: must be within 0..{_MAX_MM_H:g} mm/h")
        return wetness(self.rain)


def transfer(
    source: Annotated[str, Parameter(help="Scene file or folder, street (the built-in one), or a capture.")],
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder to write: a capture of rainy pictures.")],
    method: MethodOptions | None = None,
    views: ViewChoiceOptions | None = None,
    sheet: Annotated[Path | None, Parameter(help="Also write a picture of some views before and after.")] = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Make views rainy. gsrain recolor and gsrain reconstruct take DIR as --images.

    DIR/clear holds the original views: another program may change them, and --method images uses its results.
    """
    let_names_lead_outside(allow_outside)
    how, where = method or MethodOptions(), views or ViewChoiceOptions()
    settings, choice = how.settings, where.choice
    how.check()
    check_image("--sheet", sheet)
    check_writable(sheet, json, folders=[output])
    check_transferred_folder(output)
    lock_outputs(output)
    # Loading kernels takes a second, so import them only after the checks.
    opened = source_views(source, choice, where.capture)
    model = open_transfer(how.method, settings, opened.surroundings)
    told = msgspec.to_builtins(settings, enc_hook=str) | msgspec.to_builtins(choice)
    told["width_px"] = opened.width_px
    record = TransferRecord(how.method, opened.name, told, opened.to_world)
    rainy = write_transferred(output, model.transferred(opened.views), record, opened.mask)
    numbers = {"method": how.method, "width_px": opened.width_px} | _followed(rainy, len(opened.views), sheet)
    for note in numbers["notes"]:
        print(note)
    made = f"{numbers['views']} rainy views of {opened.name}"
    print(f"{output}: {made}, {opened.width_px} px wide, in {numbers['seconds']:.1f} s")
    if sheet is not None:
        print(sheet)
    write_numbers(json, numbers)


def _followed(rainy: Iterator[RainyView], count: int, sheet: Path | None) -> dict[str, Any]:
    """Make the views with a progress bar; returns the numbers of `--json`."""
    started, films, pictures = time.perf_counter(), list[float](), ContactSheet(count)
    made, left_out = 0, SkippedCounts()
    with progress_bar("Rainy views", count, draws=True) as advance:
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


_OPTIONS = {"source": "views", "width_px": "width", "side_px": "side", "tile_px": "tile", "sensors": "cameras"}
_MAX_MM_H = 100.0

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
        return _of_scene(source, choice, capture)
    if choice.source not in ("auto", "recorded"):
        raise ValueError(f"--views {choice.source}: {source} is a capture, whose views are those of its pictures")
    if capture is not None:
        raise ValueError(f"--capture: {source} is a capture itself")
    return _of_capture(Path(source), choice)


def _of_scene(source: str, choice: ViewChoice, capture: Path | None) -> SourceViews:
    from gsrain_engine.appearance.scene_views import scene_views  # kernels take a second to load
    from gsrain_engine.appearance.wet_look.environment import SceneEnvironment

    if choice.source == "recorded" and capture is None:
        raise ValueError("--views recorded needs --capture, where the cameras come from")
    scene = load_scene(source)
    placed = chosen_cameras(scene, choice, None if capture is None else open_capture(capture), OWN_WIDTH_PX)
    width_px = max(each.camera.width for each in placed)
    views, around = scene_views(scene, placed), SceneEnvironment(scene)
    return SourceViews(scene.name, views, around, scene.scene_to_world, width_px, lambda name: None)


def _of_capture(source: Path, choice: ViewChoice) -> SourceViews:
    from gsrain_engine.appearance.capture_views import CaptureViews
    from gsrain_engine.appearance.wet_look.environment import ImageEnvironment

    most_px = choice.width_px or OWN_WIDTH_PX
    capture = chosen_views(open_capture(source), choice)
    views, width_px = CaptureViews(capture, most_px), max(min(most_px, view.camera.width) for view in capture)
    return SourceViews(capture.name, views, ImageEnvironment(), views.to_world, width_px, views.mask)


# gsrain train-transfer

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
    """Fine-tune the transfer on two unpaired sets of images. Ctrl-C leaves the last checkpoint."""
    let_names_lead_outside(allow_outside)
    changes = {"device": device, "steps": steps, "base": base, "clip": clip, "lpips": lpips, "start": start}
    changes |= {"seed": seed, "clear": _sources(clear), "rainy": _sources(rainy)}
    settings = with_trust(lambda: load_finetuning(config, **changes), trust)
    check_writable(json, folders=[output])
    lock_outputs(output)
    task = FinetuneTask(settings=settings, output=output, resume=resume)
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


def _print(result: FinetuneResult) -> None:
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
