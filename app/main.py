"""The command line: all commands, and error reports for bad input (one line, exit code 2)."""

import logging
import os
import select
import sys
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from contextvars import copy_context
from difflib import get_close_matches
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, ArgumentCollection, CycloptsError, Group, MissingArgumentError, Parameter

from gsrain_engine import plugins
from gsrain_engine.optional_packages import MissingPackageError
from gsrain_engine.plugins import EntryPointGroup, Extension, find_extensions
from gsrain_engine.safe_io.errors import MissingInputsError, sentence_of
from ui.commands.table import BENCHMARKS, EVALUATIONS, SHELL_COMMANDS

from .console import Console, console_log, print, use_any_encoding
from .options import (
    OPTIONS,
    JsonFileOrScreen,
    Preset,
    Wet,
    all_listed,
    check_within,
    flag,
    option,
    parse_whole_numbers,
    reject_non_finite,
    window_problem,
)
from .outputs import check_writable, release_outputs, table_stream, write_numbers

if TYPE_CHECKING:
    from gsrain_engine.editor.editor import Editor

BAD_INPUT, INTERRUPTED, NOBODY_READS = 2, 130, 141
_OURS = ("gsrain", "gsrain_engine", "app")  # loggers whose info messages the command line prints
_HELP_ALL = "--help-all"
_HARMLESS = frozenset({"--help", "-h", _HELP_ALL, "--version"})  # options that need no working directory

COMMAND_TOPICS: Mapping[str, Sequence[str]] = {
    "Scenes and pictures": ("render", "info", "convert", "edit", "publish"),
    "Rain": ("export-rain", "dataset", "calibrate", "disdrometer"),
    "Captures and looks": ("reconstruct", "transfer", "train-transfer", "recolor"),
    "Tests in the rain": ("evaluate", "drive", "sweep", "serve"),
    "This program": ("doctor", "bench", "schema"),
}
"""Headings of the help, and the commands below them; those of installed packages come last."""
_TOPICS = {topic: Group(topic, sort_key=number) for number, topic in enumerate(COMMAND_TOPICS)}
_PLACES = {
    name: {"group": _TOPICS[topic], "sort_key": place}
    for topic, names in COMMAND_TOPICS.items()
    for place, name in enumerate(names)
}
_MORE = Group("More", sort_key=len(COMMAND_TOPICS))
_COMMANDS = Group.create_default_commands()

app = App(
    name="gsrain",
    help="Calibrated rain in captured 3D Gaussian Splatting scenes. Without a command: open the window.",
    version=metadata.version("gsrain"),
    help_format="plaintext",
    group_parameters=OPTIONS,
    group_commands=_MORE,
    default_parameter=Parameter(validator=reject_non_finite, converter=parse_whole_numbers),
)


@app.default
def view(
    scene: Annotated[str | None, option("Scene file or folder; default: the built-in street.")] = None,
    /,
    *,
    rain: Annotated[
        float | None, option("Rainfall intensity in mm/h, 0 to 149; the rest is the preset's.", "--rain", "--intensity")
    ] = None,
    preset: Annotated[Preset, Parameter(group=OPTIONS)] = None,
    wet: Annotated[Wet, Parameter(group=OPTIONS)] = None,
    backend: Annotated[
        Literal["auto", "opengl", "opengl-tiles", "opengl-quads", "cpu"],
        option("Renderer; auto is the fastest here: OpenGL on a GPU, else the CPU."),
    ] = "auto",
    follow_path: Annotated[bool, flag("Look through the camera that moves along the scene's path.")] = False,
) -> None:
    """Open a scene in the window; without SCENE, the built-in street."""
    check_within("--rain", rain, 0, 149, "mm/h")
    if scene is not None and not _names_scene(scene):
        from gsrain_engine.scene.open import load_scene

        load_scene(scene)  # its error suggests similar names
    if problem := window_problem():
        raise OSError(
            f"{problem}: the window can't open here; gsrain render writes pictures and videos without one, and gsrain "
            "serve --protocol browser shows a scene in a browser"
        )
    from ui.window import begin_editor, run_window  # load the GUI libraries only for the window

    def begin() -> "Editor":
        from gsrain_engine.rain.settings import load_preset  # load the engine only after the window is open

        return begin_editor(scene, load_preset(preset) if preset else None, rain, wet, follow_path=follow_path)

    run_window(begin, backend)


for name, (function, summary) in SHELL_COMMANDS.items():
    app.command(function, name=name, help=summary, **_PLACES[name])

benchmarks = App(name="bench", help="Time this machine.", group_commands=_COMMANDS, **_PLACES["bench"])
app.command(benchmarks)
for name, (function, summary) in BENCHMARKS.items():
    benchmarks.command(function, name=name, help=summary)


@benchmarks.default
def bench_all(
    *,
    scenes: Annotated[
        str, option("Names with commas between: random-200k (SH degree 0), random-3m (degree 3), street, or files.")
    ] = "random-200k,street",
    json: JsonFileOrScreen = None,
) -> None:
    """Time this machine: frames with and without rain, loading, recoloring. The commands time one, with options."""
    check_writable(json)
    from . import bench  # load the engine only here

    with redirect_stdout(table_stream(json)):
        parts = {"render": bench.render, "loading": bench.loading, "recoloring": bench.recoloring}
        numbers = {name: part(scenes=scenes) for name, part in parts.items()}
    write_numbers(json, numbers)


evaluations = App(
    name="evaluate",
    help="Measure detectors, lidars, transfers and pictures in rain.",
    group_commands=_COMMANDS,
    **_PLACES["evaluate"],
)
app.command(evaluations)
for name, (function, summary) in EVALUATIONS.items():
    evaluations.command(function, name=name, help=summary)


def run(arguments: list[str]) -> int:
    """Run the program with command-line arguments; returns the exit code."""
    use_any_encoding()
    logging.basicConfig(level=logging.WARNING, handlers=[console_log()])
    for name in _OURS:  # other libraries log messages for their developers, such as the fonts found
        logging.getLogger(name).setLevel(logging.INFO)
    errors = Console(stderr=True, soft_wrap=True)
    try:
        with _plug_ins(arguments):
            if (suggestion := _misspelled(arguments)) is not None:
                raise ValueError(suggestion)
            if not _HARMLESS.intersection(arguments) and not _has_working_directory():
                raise ValueError("the working directory was removed; cd to one that is there")
            # Run in a separate context, so that permissions of one command end with it.
            return copy_context().run(_run, spelled_out(arguments))
    except (CycloptsError, ValueError, OSError, MemoryError, ImportError) as error:
        if isinstance(error, BrokenPipeError) and _nobody_reads():
            return NOBODY_READS
        if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in _OURS:
            raise
        said = " ".join(sentence_of(error).split())
        if isinstance(error, MissingArgumentError) and error.argument is not None:
            said = f"{error.argument.name} is missing: {error.argument.parameter.help or 'see --help'}"
        if isinstance(error, ImportError) and not isinstance(error, MissingPackageError):
            said = f"a library can't be loaded: {said}; gsrain doctor says what is missing"
        if isinstance(error, MissingInputsError) and len(error.missing) > 1:
            errors.print(f"gsrain: {len(error.missing)} inputs are missing or do not fit:")
            for each in error.missing:
                errors.print(f"  {each}")
        else:
            errors.print(f"gsrain: {said}")
        return BAD_INPUT
    except KeyboardInterrupt:
        errors.print("gsrain: stopped")
        return INTERRUPTED
    except (AttributeError, TypeError) as error:  # what an older version of a library lacks, where it isn't a bug
        from .doctor import unmet_requirements  # loads NumPy

        if not (unmet := unmet_requirements([""])):
            raise
        errors.print(f"gsrain: {'; '.join(unmet.values())} ({sentence_of(error)})")
        return BAD_INPUT
    finally:
        release_outputs()


def _run(arguments: list[str]) -> int:
    """Run a command, or print its help: with --help-all all of its options, with --help the common ones."""
    with all_listed() if _HELP_ALL in arguments else nullcontext():
        words = ["--help" if each == _HELP_ALL else each for each in arguments]
        code = app(words, exit_on_error=False, print_error=False, result_action="return_value")
    if not {"--help", "-h"}.isdisjoint(arguments):
        command = app.parse_commands([each for each in arguments if each not in _HARMLESS])[1][-1]
        if command.default_command is not None and (line := _rest_of_help(command)):
            print(line)
    return code if isinstance(code, int) else 0


def _rest_of_help(command: App) -> str:
    """Return the last line of a command's help, about its options that are not listed; "" if all are."""
    arguments = command.assemble_argument_collection(parse_docstring=False)
    shown = options_in_help(arguments)
    with all_listed():
        everything = options_in_help(arguments)
    if len(shown) == len(everything):
        return ""
    return f"These are the common options. --help-all lists all {len(everything)}."


def options_in_help(arguments: ArgumentCollection) -> list[str]:
    """Return the main names of the options among a command's arguments that its help lists."""
    return [each.name for each in arguments.filter_by(show=True) if each.name.startswith("-")]


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


def _misspelled(arguments: list[str]) -> str | None:
    """Suggest a command or a built-in scene for a first word that is neither a command nor a scene; else None."""
    word = arguments[0] if arguments else ""
    names = [name for name in app if not name.startswith("-")]
    if word in names or word.startswith("-") or _names_scene(word):
        return None
    like = get_close_matches(word, [*names, *_scene_names()], 1)
    return f"{word}: no such command, and no such scene; did you mean gsrain {like[0]}?" if like else None


def _names_scene(word: str) -> bool:
    """Return whether a word names a built-in scene, or a file or folder that is there."""
    return Path(word).exists() or word in _scene_names()


def _scene_names() -> Sequence[str]:
    return [each.name for each in find_extensions(plugins.SCENES)]


def spelled_out(arguments: Iterable[str]) -> list[str]:
    """Return arguments with the only negative of a choice, --no-haze, as the choice that it is."""
    return ["--haze=none" if each == "--no-haze" else each for each in arguments]


# Commands of plug-ins


@contextmanager
def _plug_ins(arguments: Sequence[str]) -> Generator[None]:
    """Add the commands of plug-ins that these arguments may name while the block runs."""
    word, following = [*arguments, "", ""][:2]
    if word == evaluations.name[0]:
        with installed(evaluations, plugins.EVALUATIONS, following):
            yield
    elif word in SHELL_COMMANDS:
        yield
    else:
        with installed(app, plugins.COMMANDS, word, hidden=word if _opens_scene(arguments) else ""):
            yield


def _opens_scene(arguments: Sequence[str]) -> bool:
    """Return whether a first word that is a scene and a command means the scene: no place to write follows."""
    word, following = [*arguments, "", ""][:2]
    return word in _scene_names() and (not following or following.startswith("-")) and following not in _HARMLESS


@contextmanager
def installed(commands: App, point: EntryPointGroup, asked: str = "", hidden: str = "") -> Generator[None]:
    """Add the commands of a kind that plug-ins have while the block runs; only the one of the name `asked` is loaded.

    The one of the name `hidden` is left out.
    Raises `ExtensionError` with the reason if that one is unusable, ValueError if no evaluation has that name.
    """
    added, group = (
        [each for each in find_extensions(point) if each.name not in commands and each.name != hidden],
        _MORE if commands is app else None,
    )
    names = [each for each in (*commands, *(each.name for each in added)) if not each.startswith("-")]
    if commands is evaluations and asked and not asked.startswith("-") and asked not in names:
        like = get_close_matches(asked, names, 1)
        hint = f"did you mean {like[0]}?" if like else f"there is {', '.join(sorted(names))}"
        raise ValueError(f"evaluate {asked}: no such evaluation; {hint}")
    try:
        for each in added:
            if each.name == asked:
                commands.command(each.load_callable(), name=each.name, group=group)
            else:  # it appears only in the help
                commands.command(each.place, name=each.name, help=_summary(each), group=group)
        yield
    finally:
        for name in {each.name for each in added}.intersection(commands):
            del commands[name]


def _summary(extension: Extension) -> str:
    """Sentence about a command, and the package that it is of, if that is another one."""
    origin = "" if extension.package == app.name[0] else f"Of the package {extension.package} {extension.version}."
    return " ".join(filter(None, (extension.summary, origin)))
