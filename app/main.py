"""The command line: all commands, and error reports for bad input (one line, exit code 2)."""

import logging
import os
import select
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from contextvars import copy_context
from difflib import get_close_matches
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, CycloptsError, Parameter

from gsrain_engine.plugins import EVALUATIONS, Extension, ExtensionError, find_extensions
from gsrain_engine.scene.files import sentence_of

from .console import Console, console_log, use_any_encoding
from .options import (
    JsonFileOrScreen,
    has_display,
    parse_whole_numbers,
    reject_non_finite,
    release_outputs,
    table_stream,
    write_numbers,
)

if TYPE_CHECKING:
    from gsrain_engine.editor.editor import Editor

BAD_INPUT, INTERRUPTED, NOBODY_READS = 2, 130, 141
_OURS = ("gsrain", "gsrain_engine", "app")  # loggers whose info messages the command line prints
_HARMLESS = frozenset({"--help", "-h", "--version"})  # options that need no working directory

app = App(
    name="gsrain",
    help="Calibrated rain in captured 3D Gaussian Splatting scenes. Without a command: open the window.",
    version=metadata.version("gsrain"),
    help_format="plaintext",
    default_parameter=Parameter(validator=reject_non_finite, converter=parse_whole_numbers),
)

# gsrain [SCENE]


def view(
    scene: Annotated[str | None, Parameter(help="Scene file or folder; without one, the built-in street.")] = None,
    /,
    *,
    preset: Annotated[
        str | None, Parameter(help="Rain preset (clear, 1.2, 8.5, 12.0, paper) or a preset file.")
    ] = None,
    wet: Annotated[bool, Parameter(help="Begin by making the scene rainy, as its panel does.", negative="")] = False,
    backend: Annotated[
        Literal["auto", "opengl", "cpu"], Parameter(help="auto takes OpenGL on a GPU, else the processor.")
    ] = "auto",
) -> None:
    """Open a scene in the window."""
    if scene not in (None, "street") and not Path(str(scene)).exists():
        from gsrain_engine.scene.open import load_scene

        load_scene(scene)  # its error suggests similar names
    if not has_display():
        raise OSError("no display: the window can't open here; gsrain render writes pictures and videos without one")
    from ui.window import begin_session, run_window  # load the GUI libraries only for the window

    def begin() -> "Editor":
        from gsrain_engine.rain.settings import load_preset  # load the engine only after the window is open

        return begin_session(scene, load_preset(preset) if preset else None, wet)

    run_window(begin, backend)


app.default(view)

# Import strings: each command loads its modules when it runs, so that the window opens immediately.
COMMANDS = {
    "render": (
        "app.render:render",
        "Render a scene in its rain: a still, a video, frames, or raw floats.",
    ),
    "info": (
        "app.scene:info",
        "Print what is in a scene, a capture or a disdrometer's file; --check looks for wrong pictures and poses.",
    ),
    "convert": (
        "app.scene:convert",
        "Convert between scene formats.",
    ),
    "street": (
        "app.scene:street",
        "Write the built-in street: scene, tracks, camera rig, images with depth, normals and labels.",
    ),
    "calibrate": (
        "app.rain:calibrate",
        "Fit a rain calibration to disdrometer files: drop numbers, sizes and speeds by intensity.",
    ),
    "disdrometer": (
        "app.rain:disdrometer",
        "Hold a virtual disdrometer into the simulated rain, and compare with what was asked for.",
    ),
    "reconstruct": (
        "app.train:reconstruct",
        "Fit Gaussians to a capture: images with cameras, and lidar or COLMAP points where it has them.",
    ),
    "transfer": (
        "app.translate:transfer",
        "Make clear views of a scene, or the pictures of a capture, look rainy.",
    ),
    "recolor": (
        "app.train:recolor",
        "Re-optimize a scene's colours to pictures of it in another look; its geometry stays.",
    ),
    "sweep": (
        "app.sweep:sweep",
        "Run many drives or renders: every combination of scenes, scenarios, intensities, seeds and agents.",
    ),
    "train-transfer": (
        "app.translate:train_transfer",
        "Fine-tune the transfer CycleGAN-Turbo on clear and rainy pictures (LoRA).",
    ),
    "drive": (
        "app.drive:drive",
        "Test a driver in the rain: a closed loop of scene, rain and agent.",
    ),
    "doctor": (
        "app.doctor:doctor",
        "Look for everything that GSRAIN can use, and say what is missing.",
    ),
}

for name, (function, summary) in COMMANDS.items():
    app.command(function, name=name, help=summary)

benchmarks = App(name="bench", help="Time this machine.")

# gsrain bench


def bench_all(
    *,
    scenes: Annotated[
        str,
        Parameter(help="Names with commas between: random-200k (SH degree 0), random-3m (degree 3), street, or files."),
    ] = "random-200k,street",
    json: JsonFileOrScreen = None,
) -> None:
    """Time this machine: frames in rain and without, loading, recoloring. The commands time one, with options."""
    from .options import check_writable

    check_writable(json)
    from .bench import (
        loading,
        recoloring,
        render,  # load the engine only here
    )

    with redirect_stdout(table_stream(json)):
        numbers = {
            "render": render(scenes=scenes),
            "loading": loading(scenes=scenes),
            "recoloring": recoloring(scenes=scenes),
        }
    write_numbers(json, numbers)


benchmarks.default(bench_all)

benchmarks.command("app.bench:render", name="render", help="Time frames of fixed scenes, in rain and without.")

benchmarks.command("app.bench:loading", name="loading", help="Time writing and reading scenes.")

benchmarks.command("app.bench:recoloring", name="recoloring", help="Time recolouring scenes.")

app.command(benchmarks)

_CONSISTENCY = """Whether neighbouring views agree with each other, before a transfer and after it.

Views are warped onto their neighbours by depth. The error after should be that before: what a transfer does differently
in each view makes it grow. Reflections in water move with the eye: errors outside its film ("dry") are told as well.

The paper's two ablations, without normals and without mutual self-attention:

gsrain transfer SCENE -o full --method cyclegan-turbo --weights FILE

gsrain transfer SCENE -o no-normals --method cyclegan-turbo --weights FILE --no-normals

gsrain transfer SCENE -o no-attention --method cyclegan-turbo --weights FILE --no-mutual-attention

gsrain evaluate consistency full no-normals no-attention --sheet ablations.png
"""

evaluations = App(name="evaluate", help="Compare what is made with what cameras see.")

evaluations.command("app.evaluate.streaks:streaks", name="streaks", help="Rain streaks: real ones, and ours.")

evaluations.command("app.evaluate.consistency:consistency", name="consistency", help=_CONSISTENCY)

evaluations.command(
    "app.evaluate.images:fid", name="fid", help="FID and KID of pictures to real ones, with how sure they are."
)

evaluations.command(
    "app.evaluate.transfers:transfers",
    name="transfers",
    help="Compare transfers with each other, as the paper does: table and figure of a YAML file, resumable.",
)

evaluations.command(
    "app.evaluate.images:images", name="images", help="PSNR, SSIM and LPIPS of pictures of the same names."
)

evaluations.command(
    "app.evaluate.images:lpips_weights", name="lpips-weights", help="Convert LPIPS weights to plain arrays."
)

evaluations.command(
    "app.evaluate.images:inception_weights",
    name="inception-weights",
    help="Convert the Inception weights of FID to plain arrays.",
)

evaluations.command(
    "app.evaluate.detection:detection",
    name="detection",
    help="What rain does to object detectors: confidence, boxes, classes and mAP by intensity.",
)

evaluations.command(
    "app.evaluate.lidar:lidar", name="lidar", help="A lidar in rain: returns kept, lost and made up, by range."
)

_OUR_EVALUATIONS = frozenset(evaluations)

app.command(evaluations)


def run(arguments: list[str]) -> int:
    use_any_encoding()
    logging.basicConfig(level=logging.WARNING, handlers=[console_log()])
    for name in _OURS:  # other libraries log messages for their developers, such as the fonts found
        logging.getLogger(name).setLevel(logging.INFO)
    errors = Console(stderr=True, soft_wrap=True)
    try:
        return _run(arguments, errors)
    finally:
        release_outputs()


def _run(arguments: list[str], errors: Console) -> int:
    if (meant := _misspelt(arguments)) is not None:
        errors.print(f"gsrain: {meant}")
        return BAD_INPUT
    if not _HARMLESS.intersection(arguments) and not _has_working_directory():
        errors.print("gsrain: the working directory was removed; cd to one that is there")
        return BAD_INPUT
    if arguments[:1] == ["evaluate"]:
        add_installed_evaluations(evaluations, _OUR_EVALUATIONS, arguments[1:])
    try:
        # Run in a separate context, so that permissions of one command end with it.
        code = copy_context().run(app, arguments, exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as error:
        errors.print(f"gsrain: {_one_line(str(error))}")
        return BAD_INPUT
    except (ValueError, OSError, MemoryError) as error:
        if isinstance(error, BrokenPipeError) and _nobody_reads():
            return NOBODY_READS
        errors.print(f"gsrain: {_one_line(sentence_of(error))}")
        return BAD_INPUT
    except ImportError as error:
        if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in _OURS:
            raise
        errors.print(f"gsrain: a library can't be loaded: {_one_line(str(error))}; gsrain doctor says what is missing")
        return BAD_INPUT
    except KeyboardInterrupt:
        errors.print("gsrain: stopped")
        return INTERRUPTED
    return code if isinstance(code, int) else 0


def _has_working_directory() -> bool:
    try:
        return Path.cwd().is_dir()
    except OSError:
        return False


def _nobody_reads() -> bool:
    """Return True if the reader of standard output has closed it, as `head` does; silences further output."""
    try:
        poll = select.poll()
        poll.register(sys.stdout.fileno(), 0)
        is_broken = any(event & select.POLLERR for _, event in poll.poll(0))
        if is_broken:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python raises again at exit
    except (AttributeError, OSError, ValueError):  # no poll, no file descriptor, or a closed one
        return False
    return is_broken


def _misspelt(arguments: list[str]) -> str | None:
    """Suggest a command for a first word that is neither a command nor a scene; else None."""
    word = arguments[0] if arguments else ""
    names = [name for name in app if not name.startswith("-")]
    like = get_close_matches(word, names, 1)
    if not like or word in names or word.startswith("-") or Path(word).exists():
        return None
    return f"{word}: no such command, and no such scene; did you mean gsrain {like[0]}?"


def _one_line(message: str) -> str:
    return " ".join(message.split())


# Evaluations of other installed packages


def add_installed_evaluations(evaluations: App, ours: frozenset[str], asked: Sequence[str]) -> None:
    """Add the evaluations of other packages; only the one that `asked` begins with is loaded.

    If that one is unusable, running it raises the reason.
    """
    for name in set(evaluations) - ours:  # from an earlier run
        del evaluations[name]
    for each in find_extensions(EVALUATIONS):
        if each.name in ours:
            continue
        if list(asked[:1]) == [each.name]:
            evaluations.command(_function(each), name=each.name)
        else:
            evaluations.command(_listed, name=each.name, help=f"Of the package {each.package} {each.version}.")


def _function(extension: Extension) -> Callable[..., object]:
    try:
        return extension.load_callable()
    except ExtensionError as error:
        problem = error

        def unfit(*_: str) -> None:
            raise problem

        return unfit


def _listed() -> None:
    """Placeholder for a command that appears only in the help."""
