"""Help of every command: the common options by topic in --help, all of them in --help-all, and their names in --set."""

import re
import subprocess
import sys

import pytest
from cyclopts import App

from app.main import COMMAND_TOPICS, app, evaluations, installed, options_in_help, run
from app.options import TOPICS, all_listed
from gsrain_engine import plugins
from gsrain_engine.choices import FACTORS, READ_FORMATS, WRITTEN_FORMATS
from gsrain_engine.evaluation.attribution.factors import factor_names
from gsrain_engine.scene.formats.registry import FORMATS
from repository import REPOSITORY

MAX_SHOWN = 25
"""More options than this, and nobody reads them."""


def commands(parent: App = app, words: tuple[str, ...] = ()):
    for name in parent:
        if not name.startswith("-"):
            yield (*words, name)
            yield from commands(parent[name], (*words, name))


with installed(app, plugins.COMMANDS), installed(evaluations, plugins.EVALUATIONS):
    COMMANDS = [(), *commands()]


@pytest.fixture(autouse=True)
def _with_installed_commands():
    with installed(app, plugins.COMMANDS), installed(evaluations, plugins.EVALUATIONS):
        yield


def command_of(words: tuple[str, ...]) -> App:
    found = app
    for word in words:
        found = found[word]
    return found


def help_of(words, flag, capsys):
    """The main names of the options in a printed help, in their order, its headings, and its last line."""
    assert run([*words, flag]) == 0
    text = capsys.readouterr().out
    with all_listed():
        names = (
            options_in_help(command_of(words).assemble_argument_collection())
            if command_of(words).default_command is not None
            else []
        )
    shown = [each for each in names if re.search(rf"^│ .{{0,5}}{each}(?![\w-])", text, re.MULTILINE)]
    return shown, re.findall(r"^╭─ ([A-Z][a-z ]*?) ─", text, re.MULTILINE), text.rstrip().splitlines()[-1]


def test_each_command_is_below_a_heading_that_says_what_it_is_for(capsys):
    listed = [name for names in COMMAND_TOPICS.values() for name in names]
    own = [name for name in app if not name.startswith("-") and name not in installed_names()]
    assert sorted(listed) == sorted(own)
    assert run(["--help"]) == 0
    text = capsys.readouterr().out
    places = [text.index(f"─ {topic} ─") for topic in COMMAND_TOPICS]
    assert places == sorted(places) and text.index("│ render ") < text.index("│ convert ") < places[1]


def installed_names() -> set[str]:
    return {each.name for each in plugins.find_extensions(plugins.COMMANDS)}


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_help_lists_the_common_options_and_help_all_lists_all(words, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "150")
    shown, headings, line = help_of(words, "--help", capsys)
    everything, all_headings, last = help_of(words, "--help-all", capsys)
    assert len(shown) <= MAX_SHOWN and set(shown) <= set(everything) and "--help-all" not in last
    assert ("--help-all" in line) == (len(shown) < len(everything))
    if len(shown) < len(everything):
        assert line.endswith(f"--help-all lists all {len(everything)}.")
    assert set(all_headings) <= {*TOPICS, *COMMAND_TOPICS, "Arguments", "Commands"}
    assert [each for each in all_headings if each in headings] == headings


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_option_is_listed_under_one_topic(words):
    command = command_of(words)
    if command.default_command is None:
        return
    options = [each for each in command.assemble_argument_collection() if each.name.startswith("-") and each.parse]
    assert all([group.name in TOPICS for group in each.parameter.group] == [True] for each in options)


def test_a_rare_option_works_without_being_listed():
    assert "--contact-angle" not in options_in_help(command_of(("render",)).assemble_argument_collection())
    _, bound, _ = app.parse_args(["render", "-o", "a.png", "--contact-angle", "40"], exit_on_error=False)
    assert bound.arguments["rain"].changes() == {"contact_angle_deg": 40.0}


# Time


HEAVY = "torch numpy scipy numba cv2 av moderngl pandas matplotlib PIL zstandard onnxruntime imgui_bundle"


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_help_loads_nothing_heavy(words):
    program = (
        "import sys; from app.main import run; code = run(sys.argv[2:]);"
        "sys.exit(code or ' '.join({each.partition('.')[0] for each in sys.modules} & set(sys.argv[1].split())) or 0)"
    )
    command = [sys.executable, "-c", program, HEAVY, *words, "--help"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, cwd=REPOSITORY)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr


def test_the_choices_of_help_texts_are_those_of_the_engine():
    assert tuple(each.suffix for each in FORMATS) == READ_FORMATS
    assert tuple(each.suffix for each in FORMATS if each.write is not None) == WRITTEN_FORMATS
    assert factor_names() == FACTORS


def test_the_agent_comes_before_its_options():
    options = options_in_help(command_of(("drive",)).assemble_argument_collection())
    assert options.index("--agent") < options.index("--detector") < options.index("--hugsim-dir")
