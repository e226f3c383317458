"""Names that steer a terminal, turn the reading direction or look like markup, through commands."""

import json
import logging
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.console import Console, print_lines, run_with_progress, use_any_encoding
from app.console import print as print_line
from app.main import BAD_INPUT, run
from gsrain_engine.report.page import RunReport, report_page
from gsrain_engine.report.table import Table, columns
from gsrain_engine.safe_io.text_files import escape_invisible, figure_words
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Actor, PoseTrack
from small_scene import small_scene

NAME = "\x1b]0;owned\x07\u202e[red][/x]\nOK\u2066"
"""A title of the window, a turned reading direction, markup that closes what is not open, a line of its own."""
ESCAPED = r"\x1b]0;owned\x07\u202e[red][/x]\nOK\u2066"
FILE = NAME.replace("/", "")
"""The same as a file's name."""
_STYLES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def clean(text: str) -> str:
    """Return printed text without styles; fails for anything in it that is neither printable nor the end of a line."""
    text = _STYLES.sub("", text).replace("\r", "")
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


def _pictures(folder: Path, shade: int) -> Path:
    folder.mkdir(parents=True)
    values = np.random.default_rng(0).integers(0, 200, (16, 24, 3)).astype(np.uint8)
    for name in (FILE, "plain"):
        Image.fromarray(values + np.uint8(shade)).save(folder / f"{name}.png")
    return folder


def _two(place: Path) -> list[str]:
    return [str(_pictures(place / "shown", 0)), str(_pictures(place / "truth", 20))]


def _settings(place: Path) -> list[str]:
    """A file of settings with an unknown field of such a name."""
    (place / f"{FILE}.yaml").write_text(f'"{json.dumps(NAME)[1:-1]}": 1\n')
    return ["evaluate", "transfers", str(place / f"{FILE}.yaml"), "-o", str(place / "out")]


WAYS = {
    "info": (lambda place: ["info", str(_scene(place))], 0),
    "images": (lambda place: ["evaluate", "images", *_two(place), "--report", str(place / "r.html")], 0),
    "settings": (_settings, BAD_INPUT),
    "view": (lambda place: [str(place / f"missing {FILE}")], BAD_INPUT),
}
"""Names in scenes, settings and files; all commands print by one door (test_architecture.py)."""


@pytest.mark.parametrize("way", WAYS)
def test_a_name_is_printed_as_it_is_and_steers_nothing(way, place, capsys):
    arguments, code = WAYS[way]
    assert run(arguments(place)) == code
    out, err = capsys.readouterr()
    assert not _STYLES.search(out + err)
    printed = clean(out) + clean(err)
    assert r"\x1b" in printed and r"\u202e" in printed, printed
    assert "Traceback" not in printed


def test_nor_in_a_terminal(place, capsys, monkeypatch):
    def work():
        yield Progress(0.5, f"1 of 2: {NAME}", warning=f"beware of {NAME}")

    for variable, value in (("FORCE_COLOR", "1"), ("TERM", "xterm"), ("COLUMNS", "200")):
        monkeypatch.setenv(variable, value)
    assert run(["evaluate", "images", *_two(place)]) == 0
    out, err = capsys.readouterr()
    assert "\x1b[" in err  # a terminal it is: the bar has colors
    assert ESCAPED.replace("/", "") in clean(out)
    clean(err)
    run_with_progress(work())
    assert f"beware of {ESCAPED}" in clean(capsys.readouterr().err)


def test_tables_and_lines(tmp_path, capsys, monkeypatch):
    table = Table("", columns((f"name_{NAME}".replace(" ", "_"),)), [(f"[bold]{NAME}",)], f"caption {NAME}")
    print_lines(table.text)
    console = Console(width=300)
    console.print(f":warning: {NAME}", style="dim")
    print_line(NAME, 3)
    print_lines(f"one {NAME.replace(chr(10), '')}\ntwo\n")
    printed = clean(capsys.readouterr().out)
    for words in ("name_", "[bold]", "caption ", ":warning: "):
        assert words + ESCAPED in printed
    assert f"\n{ESCAPED} 3\n" in printed and printed.endswith("\ntwo\n")
    with (tmp_path / "out").open("w", encoding="ascii") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        use_any_encoding()
        print_line("Straße \udcff")
    assert (tmp_path / "out").read_text() == "Stra\\xdfe \\udcff\n"


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
    assert printed.startswith(f"left out {ESCAPED}\n") and "Traceback" in printed


def test_pages_and_figures():
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    table = Table(NAME, columns(("column",)), ((NAME,),))
    report = RunReport(f"<script>{NAME}", {NAME: NAME}, problems=(NAME,), notes=(NAME,), tables=(table,))
    page = clean(report_page(report))
    assert page.count(ESCAPED) >= 5 and "<script>\\x1b" not in page
    figure = Figure()
    axes = figure.subplots()
    for name in ("$\\notacommand{$", "_hidden", "costs $5"):
        axes.plot([0, 1], label=figure_words(name))
    axes.set_title(figure_words("$x^$ \u202e"))
    legend = axes.legend()
    FigureCanvasAgg(figure).draw()  # a formula that can't be read is a ValueError
    assert [each.get_text().strip() for each in legend.get_texts()][1] == "_hidden"
    assert figure_words("$x^$ \u202e") == "\\$x^\\$ \\u202e"
    assert escape_invisible("Zürich 東京　1, naïve") == "Zürich 東京　1, naïve"
    assert escape_invisible("a\tb\r\x00\x9b\u200f\u2069\ufeff") == "a\\tb\\r\\x00\\x9b\\u200f\\u2069\\ufeff"
