"""Names that steer a terminal, turn the reading direction or look like markup, through every command."""

import json
import logging
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image

from app import main, train, translate
from app.console import Console, Table, bold, print_lines, progress_bar, run_with_progress, use_any_encoding
from app.console import print as print_line
from app.doctor import Finding
from app.main import run
from gsrain_engine.datasets.capture import Capture
from gsrain_engine.evaluation.report import ReportTable, RunReport, report_page
from gsrain_engine.safe_io.text_files import escape_invisible, figure_words
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Actor, PoseTrack
from small_scene import small_scene
from sweep.small_sweep import write_road, write_scenario

NAME = "\x1b]0;owned\x07\u202e[red][/x]\nOK\u2066"
"""A title of the window, a turned reading direction, markup that closes what is not open, a line of its own."""
SHOWN = r"\x1b]0;owned\x07\u202e[red][/x]\nOK\u2066"
FILE = NAME.replace("/", "")
"""The same as a file's name."""
_STYLES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def clean(text: str) -> str:
    """Return what was printed; fails for anything in it that is neither a letter nor the end of a line."""
    assert [sign for sign in text if not sign.isprintable() and sign != "\n"] == [], repr(text)
    return text


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder below which `[/x]` is a part of a path that exists."""
    folder = tmp_path / FILE.replace("[x]", "[") / "x]"
    folder.mkdir(parents=True)
    return folder


def _scene(place: Path) -> Path:
    scene = small_scene(NAME)
    track = PoseTrack(np.arange(2.0), np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))
    layers = tuple(replace(each, name=f"{each.name} {NAME}") for each in scene.layers)
    actor = Actor(f"id {NAME}", f"class {NAME}", (4.0, 2.0, 1.5), scene.layers[0].gaussians, track)
    rigs = {f"rig {NAME}": tuple(replace(each, name=f"camera {NAME}") for each in scene.rigs["one"])}
    write_scene(replace(scene, layers=layers, actors=(actor,), rigs=rigs), place / "scene")
    return place / "scene"


def _flat(place: Path) -> Path:
    write_scene(small_scene(), place / f"{FILE}.ply")
    return place / f"{FILE}.ply"


def _pictures(folder: Path, shade: int) -> Path:
    folder.mkdir(parents=True)
    values = np.random.default_rng(0).integers(0, 200, (16, 24, 3)).astype(np.uint8)
    for name in (FILE, "plain"):
        Image.fromarray(values + np.uint8(shade)).save(folder / f"{name}.png")
    return folder


def _capture(place: Path) -> Path:
    """A nerfstudio capture whose pictures and camera model have such names."""
    folder = _pictures(place / "capture", 0)
    frames = [
        {"file_path": f"{name}.png", "transform_matrix": np.eye(4).tolist()} for name in (FILE, "plain", f"no {FILE}")
    ]
    intrinsics = {"fl_x": 20.0, "fl_y": 20.0, "cx": 12.0, "cy": 8.0, "w": 24, "h": 16}
    (folder / "transforms.json").write_text(json.dumps({**intrinsics, "frames": frames}))
    return folder


def _log(place: Path) -> str:
    (place / f"{FILE}.txt").write_text(f"{NAME};1;2\n" * 3)
    return str(place / f"{FILE}.txt")


def _sweep(place: Path) -> list[str]:
    scenario = write_scenario(place / "short.yaml", write_road(place / f"{FILE}road"))
    text = scenario.read_text().replace("name: short", f"name: {json.dumps(NAME)}")
    scenario.write_text(text.replace("id: lead", f"id: lead\n  model: {json.dumps(NAME + '.ply')}"))
    file = place / f"{FILE}.yaml"
    agents = [{"name": "constant-velocity", "label": f"agent {NAME}"}]
    values = {"kind": "drive", "scenarios": [str(scenario)], "intensities_mm_h": [0], "seeds": 1, "agents": agents}
    file.write_text(json.dumps(values))
    return ["sweep", str(file), "--workers", "0", "-o", str(place / "out")]


def _drive(place: Path) -> list[str]:
    scenario = write_scenario(place / "short.yaml", write_road(place / f"{FILE}road"))
    words = {"name: short": f"name: {json.dumps(NAME)}", "id: lead": f"id: {json.dumps(NAME)}"}
    text = scenario.read_text()
    for old, new in words.items():
        assert old in text
        text = text.replace(old, new)
    scenario.write_text(text)
    options = ["--agent", "constant-velocity", "--no-video", "-o", str(place / "drive")]
    return ["drive", str(scenario), *options]


def _field(place: Path, *command: str) -> list[str]:
    """A file of settings with an unknown field of such a name."""
    file = place / f"{FILE}.yaml"
    file.write_text(f'"{json.dumps(NAME)[1:-1]}": 1\n')
    return [*command, str(file)]


class Way(NamedTuple):
    """A command, and how names get into it."""

    command: str
    arguments: Callable[[Path], list[str]]
    code: int = 2


def _missing(*words: str) -> Callable[[Path], list[str]]:
    """Arguments in which `{}` is a file that is not there."""
    return lambda place: [each.format(place / f"missing {FILE}") for each in words]


WAYS = (
    Way("info", lambda place: ["info", str(_scene(place))], 0),
    Way("info", lambda place: ["info", str(_capture(place)), "--check"], 0),
    Way("convert", lambda place: ["convert", str(_flat(place)), str(place / f"{FILE}.splat")], 0),
    Way("calibrate", lambda place: ["calibrate", _log(place), "-o", str(place / "c.yaml")]),
    Way("sweep", _sweep, 1),
    Way("sweep", lambda place: _field(place, "sweep")),
    Way("drive", _drive, 0),
    Way("drive", lambda place: _field(place, "drive")),
    Way("evaluate images", lambda place: ["evaluate", "images", *_two(place), "--report", str(place / "r.html")], 0),
    Way("evaluate fid", _missing("evaluate", "fid", "{}", "{}", "--extractor", "pixels16")),
    Way("evaluate transfers", lambda place: [*_field(place, "evaluate", "transfers"), "-o", str(place / "out")]),
    Way("evaluate detection", _missing("evaluate", "detection", "{}", "--detector", "{}.onnx")),
    Way("evaluate streaks", _missing("evaluate", "streaks", "{}")),
    Way("evaluate consistency", _missing("evaluate", "consistency", "{}")),
    Way("evaluate lidar", _missing("evaluate", "lidar", "{}", "-o", "{}.npz")),
    Way("evaluate lpips-weights", _missing("evaluate", "lpips-weights", "{}", "{}", "-o", "{}.npz")),
    Way("evaluate inception-weights", _missing("evaluate", "inception-weights", "{}", "-o", "{}.npz")),
    Way("train-transfer", lambda place: [*_field(place, "train-transfer"), "-o", str(place / "out")]),
    Way("reconstruct", _missing("reconstruct", "{}", "-o", "{}.scene")),
    Way("transfer", _missing("transfer", "{}", "-o", "{}.out", "--rain", "5")),
    Way("recolor", _missing("recolor", "{}", "--images", "{}", "-o", "{}.scene")),
    Way("render", _missing("render", "{}", "-o", "{}.png")),
    Way("street", lambda place: ["street", str(_flat(place) / "below")]),
    Way("disdrometer", lambda place: ["disdrometer", "-o", str(_flat(place) / "below.nc")]),
    Way("bench render", _missing("bench", "render", "--scenes", "{}")),
    Way("bench loading", _missing("bench", "loading", "--scenes", "{}")),
    Way("bench recoloring", _missing("bench", "recoloring", "--scenes", "{}")),
    Way("doctor", lambda place: ["doctor"], 0),
    Way("view", _missing("{}")),
)


def _two(place: Path) -> list[str]:
    return [str(_pictures(place / "shown", 0)), str(_pictures(place / "truth", 20))]


def commands() -> Iterator[str]:
    """Every command of the program."""
    yield "view"
    yield from main.COMMANDS
    yield from (f"bench {name}" for name in main.benchmarks if not name.startswith("-"))
    yield from (f"evaluate {name}" for name in main._OUR_EVALUATIONS if not name.startswith("-"))


def test_the_table_has_every_command():
    assert {way.command for way in WAYS} == set(commands())


@pytest.fixture
def installed(monkeypatch):
    """Pretend that doctor finds only a package whose words are such, and no graphics, which take seconds."""
    from app import doctor

    found = Finding(NAME, True, f"OpenGL of {NAME}")
    for name in [each for each in vars(doctor) if each.startswith(("_", "find_")) and each not in ("__builtins__",)]:
        value = getattr(doctor, name)
        if callable(value) and name not in ("_tried",) and getattr(value, "__module__", "") == doctor.__name__:
            monkeypatch.setattr(doctor, name, lambda *_: found)
    monkeypatch.setattr(doctor, "find_depth_order", lambda: [found])


@pytest.mark.parametrize("way", WAYS, ids=[f"{place} {way.command}" for place, way in enumerate(WAYS)])
def test_a_name_is_printed_as_it_is_and_steers_nothing(way, place, capsys, installed):
    assert run(way.arguments(place)) == way.code
    out, err = capsys.readouterr()
    printed = clean(out) + clean(err)
    assert r"\x1b" in printed and r"\u202e" in printed, printed
    assert "Traceback" not in printed


def test_nor_in_a_terminal(place, capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    arguments = ["evaluate", "images", *_two(place)]
    assert run(arguments) == 0
    out, err = capsys.readouterr()
    assert "\x1b[1m" in out  # a terminal it is: the line of means is bold
    assert SHOWN.replace("/", "") in clean(_STYLES.sub("", out))
    clean(_STYLES.sub("", err).replace("\r", ""))


def test_titles_and_messages_of_progress(capsys, monkeypatch):
    def work():
        yield Progress(0.5, f"1 of 2: {NAME}", warning=f"beware of {NAME}")
        return 3

    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "200")
    with progress_bar(f"Timing {NAME}", 1) as advance:
        advance()
    assert run_with_progress(work()) == 3
    printed = clean(_STYLES.sub("", capsys.readouterr().err).replace("\r", ""))
    assert f"Timing {SHOWN}" in printed and f"beware of {SHOWN}" in printed


def test_cells_titles_and_bold_ones(capsys):
    table = Table(f"name {NAME}", title=f"title {NAME}", box=None)
    table.add_row(f"[bold]{NAME}")
    table.add_row(bold(f"bold {NAME}"))
    console = Console(width=300)
    console.print(table)
    console.print(f":warning: {NAME}", style="dim")
    print_line(NAME, 3)
    print_lines(f"one {NAME.replace(chr(10), '')}\ntwo\n")
    printed = clean(capsys.readouterr().out)
    for words in (f"name {SHOWN}", f"title {SHOWN}", f"[bold]{SHOWN}", f"bold {SHOWN}", f":warning: {SHOWN}"):
        assert words in printed
    assert f"\n{SHOWN} 3\n" in printed and printed.endswith("\ntwo\n")


def test_results_of_long_commands(capsys):
    """Names of views in results that take minutes or torch to make."""

    class Anything:
        """A result whose every word is such, and whose every figure is 1."""

        problems, views, table, losses = (NAME,), (), ((NAME, "clear", 3, 1),), {f"loss_{NAME}": 1.0}
        warning, weights, grid = NAME, Path(FILE), Path(FILE)
        perceptual, steps, seconds = False, 1, 1.0

    translate._print(Anything())
    with pytest.raises(AttributeError):  # the problems are printed before what is missing here
        train._print_recolor(Anything(), Capture("c", (), problems=(NAME,)))
    with pytest.raises(AttributeError):
        train._print(Anything())
    assert clean(capsys.readouterr().out).count("\\u202e") >= 6


def test_records_of_the_log(capsys, monkeypatch):
    root, logger = logging.getLogger(), logging.getLogger("gsrain")
    monkeypatch.setattr(root, "handlers", [])
    run(["convert", "none.ply"])  # begins the log
    capsys.readouterr()
    monkeypatch.setattr(root.handlers[0], "stream", sys.stderr)
    logger.warning("left out %s", NAME)
    try:
        raise KeyError(NAME)
    except KeyError:
        logger.exception("a fault in %s", NAME)
    printed = clean(capsys.readouterr().err)
    assert printed.startswith(f"left out {SHOWN}\n") and "Traceback" in printed


def test_letters_that_an_encoding_lacks(tmp_path, monkeypatch):
    with (tmp_path / "out").open("w", encoding="ascii") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        use_any_encoding()
        print_line("Straße \udcff")
    assert (tmp_path / "out").read_text() == "Stra\\xdfe \\udcff\n"


def test_a_closed_stream_takes_nothing(monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)  # as after >&- in a shell
    print_line("nobody reads it")


def test_a_page_names_them_as_they_are():
    table = ReportTable(NAME, ("column",), ((NAME,),))
    report = RunReport(f"<script>{NAME}", {NAME: NAME}, problems=(NAME,), notes=(NAME,), tables=(table,))
    page = report_page(report)
    assert page.count(SHOWN) >= 5 and "<script>\\x1b" not in page
    clean(page)


def test_a_figure_takes_no_name_for_a_formula():
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure()
    axes = figure.subplots()
    for name in ("$\\notacommand{$", "_hidden", "costs $5"):
        axes.plot([0, 1], label=figure_words(name))
    axes.set_title(figure_words("$x^$ \u202e"))
    legend = axes.legend()
    FigureCanvasAgg(figure).draw()  # a formula that can't be read is a ValueError
    assert [each.get_text().strip() for each in legend.get_texts()][1] == "_hidden"
    assert figure_words("$x^$ \u202e") == "\\$x^\\$ \\u202e"


def test_what_is_escaped():
    assert escape_invisible("Zürich 東京　1, naïve") == "Zürich 東京　1, naïve"
    assert (
        escape_invisible("a\tb\r\x00\x9b\u200f\u2069\u2028\ufeff") == "a\\tb\\r\\x00\\x9b\\u200f\\u2069\\u2028\\ufeff"
    )
