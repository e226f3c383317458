"""Pages, headings, pictures, commands and options that the documentation names exist."""

import importlib.util
import posixpath
import re
from pathlib import Path

import pytest
import yaml
from cyclopts import CycloptsError, UnknownCommandError, UnknownOptionError

import gsrain as gr
from app.main import app, benchmarks, evaluations, installed, spelled_out
from docs import figures, tables
from documentation import PAGES, anchors_of, commands_of, links_of, text_of
from gsrain_engine import plugins
from repository import REPOSITORY
from ui.commands.keys import chord_name
from ui.commands.table import COMMANDS, SHELL_COMMANDS
from ui.panels.registry import BUILT_IN_PANELS
from ui.tools import TOOLS

OF_EXTENSIONS = {"contrast", "NAME", "count", "site"}
"""Commands, evaluations and settings of the examples in docs/extending.md."""
OF_EXTENSIONS |= {"streaks", "rain-gauge", "night"} - {
    each.name for group in (plugins.EVALUATIONS, plugins.COMMANDS) for each in plugins.find_extensions(group)
}
SITE = yaml.safe_load((REPOSITORY / "mkdocs.yml").read_text(encoding="utf-8"))
LISTED = [each for page in PAGES for each in commands_of(page)]


@pytest.fixture(scope="module")
def site_pages():
    spec = importlib.util.spec_from_file_location("site_pages", REPOSITORY / "docs" / "site_pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_links_lead_somewhere(page):
    for link in links_of(page):
        target, _, anchor = link.partition("#")
        place = REPOSITORY / (posixpath.normpath(page.parent / target) if target else page)
        assert place.exists(), f"{page}: {link}"
        if anchor and place.suffix == ".md":
            assert anchor in anchors_of(place.relative_to(REPOSITORY)), f"{page}: {link}"


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_rows_belong_to_a_table(page):
    lines, is_code = text_of(page).splitlines(), False
    for number, (before, line, after) in enumerate(zip(["", *lines], lines, [*lines[1:], ""], strict=False), start=1):
        is_code ^= line.startswith("```")
        if line.startswith("|") and not before.startswith("|") and not is_code:
            assert re.fullmatch(r"[|: -]*-[|: -]*", after), f"{page}:{number}: a table without a head"


def _in_nav(entries):
    for entry in entries:
        for each in [entry] if isinstance(entry, str) else entry.values():
            yield from [each] if isinstance(each, str) else _in_nav(each)


def test_every_page_is_in_the_menu_of_the_site(site_pages):
    in_docs = {str(page.relative_to("docs")) for page in PAGES if page.parts[0] == "docs"}
    listed = list(_in_nav(SITE["nav"]))
    assert len(listed) == len(set(listed))
    assert set(listed) == in_docs | set(site_pages.ELSEWHERE.values()) | {"api.md", "commands.md", "settings.md"}
    assert all((REPOSITORY / source).is_file() for source in site_pages.ELSEWHERE)


@pytest.mark.street
@pytest.mark.parametrize("command", figures.FIGURES)
def test_figures_of_pages_are_what_the_command_prints(command, tmp_path):
    """Within one of the last digit, by which processors may differ."""
    numbers = figures.numbers_of(command, tmp_path)
    for figure in figures.FIGURES[command]:
        there, now = figures.written(figure), figure.text(numbers)
        for printed, found in zip(numbers_in(there), numbers_in(now), strict=True):
            last_digit = 10.0 ** -len(printed.partition(".")[2])
            assert abs(float(printed) - float(found)) < 1.01 * last_digit, "python -m docs.figures writes them"


def numbers_in(text):
    return re.findall(r"\d+(?:\.\d+)?", text.replace(",", ""))


@pytest.mark.parametrize("page", tables.PAGES)
def test_tables_of_pages_are_those_of_the_program(page):
    text = text_of(Path("docs") / page)
    assert text == tables.updated(page), "python -m docs.tables writes them"
    assert "<!-- tables -->" in text and "|  |  |" not in text


def test_every_panel_has_a_sentence():
    assert all(each.help.endswith(".") for each in BUILT_IN_PANELS)


def test_keys_of_the_pages_are_those_of_the_window():
    chords = {name for command in COMMANDS for name in re.split(r", | or ", command.key_names)}
    tools = {tool.name: chord_name(int(tool.key)) if tool.key is not None else "" for tool in TOOLS}
    pages = {page: text_of(page) for page in PAGES if page.parts[0] == "docs"}
    named = [
        each for text in pages.values() for each in re.findall(r"(?:(?:Ctrl|Shift|Alt)\+)+(?:[A-Z]\w*|[][]|F\d+)", text)
    ]
    assert len(named) > 20 and set(named) <= chords | {"Alt+Up"}  # of the file dialog
    rows = [
        row for text in pages.values() for row in re.findall(r"^\| (\w[\w ]*?)(?: \((\w)\))? \|", text, re.MULTILINE)
    ]
    assert {name: key for name, key in rows if name in tools} == tools


@pytest.mark.parametrize(
    ("text", "source", "page", "expected"),
    [
        ("[a](docs/faq.md#x)", "README.md", "index.md", "[a](faq.md#x)"),
        ("[a](../../CONTRIBUTING.md#b)", "docs/guide/rain.md", "guide/rain.md", "[a](../contributing.md#b)"),
        ("[a](https://b.org/c.md)", "README.md", "index.md", "[a](https://b.org/c.md)"),
    ],
)
def test_links_lead_to_where_texts_are_in_the_site(site_pages, text, source, page, expected):
    assert site_pages.with_site_links(text, source, page) == expected


def test_the_reference_names_every_command(site_pages):
    text = site_pages.commands_page()
    assert text.startswith("# Commands\n\nWhat `gsrain COMMAND --help-all` says")
    headings = set(re.findall(r"^#+ (.*)$", text, re.MULTILINE))
    installed = {each.name for each in plugins.find_extensions(plugins.COMMANDS)}
    assert {each.words[0] for each in LISTED if each.words} >= {*SHELL_COMMANDS, *installed, "evaluate", "bench"}
    names = {
        *SHELL_COMMANDS,
        *installed,
        *(f"evaluate {each}" for each in evaluations),
        *(f"bench {each}" for each in benchmarks),
    }
    expected = {f"gsrain {name}" for name in names if "--" not in name and not name.endswith(" -h")}
    assert expected <= headings | {each.strip("`") for each in headings}
    assert "--intensities" in text and "[required]" in text and "**Parameters**" not in text


def test_the_reference_has_every_name_with_its_arguments_and_pictures(site_pages):
    text = site_pages.api_page()
    assert sorted(re.findall(r"^### (\w+)$", text, re.MULTILINE)) == sorted(gr.__all__)
    assert (
        "* `exposure`: Shutter time in s; None takes that of a `sensor`" in text and "`ValueError`: For a size" in text
    )
    assert "| `save(path)` | Save as .png, .jpg" in text and "Args:" not in text and "|  |" not in text
    pictures = re.findall(r"\]\((images/\S+)\)", text)
    assert len(pictures) == 4 and all((REPOSITORY / "docs" / each).is_file() for each in pictures)


@pytest.mark.parametrize("name", sorted({each.words[0] if each.words else "" for each in LISTED}))
def test_commands_of_the_documentation_are_those_of_the_program(name):
    for command in LISTED:
        words = command.words
        if (words[0] if words else "") != name or not OF_EXTENSIONS.isdisjoint(words[:2]) or "--help" in words:
            continue
        try:
            with installed(app, plugins.COMMANDS), installed(evaluations, plugins.EVALUATIONS):
                app.parse_args(spelled_out(words), exit_on_error=False, print_error=False)
        except CycloptsError as error:
            if not command.is_whole and not isinstance(error, UnknownOptionError | UnknownCommandError):
                continue
            pytest.fail(f"{command.page}:{command.line}: gsrain {' '.join(words)}: {' '.join(str(error).split())}")
