"""The table of commands: all that a row names exists, and the edits of the window's commands are those of its steps."""

from typing import get_args

import gsrain as gr
from gsrain_engine.choices import RenderMode
from gsrain_engine.editor.steps import all_edits
from gsrain_engine.editor.viewport.options import Split
from ui.commands.table import (
    BENCHMARKS,
    COMMANDS,
    EVALUATIONS,
    RENDER_MODES,
    SHELL_COMMANDS,
    SPLITS,
    all_commands,
    function_at,
    help_of,
)


def test_all_that_rows_name_exists():
    places = [place for each in all_commands() for place in (each.run, each.is_possible, each.is_on, each.more)]
    places += [function for table in (SHELL_COMMANDS, EVALUATIONS, BENCHMARKS) for function, _ in table.values()]
    found = [function_at(place) for place in places if isinstance(place, str)]
    assert len(found) > 50 and all(map(callable, found))
    assert {each.edit for each in all_commands()} <= {"", *all_edits()}
    assert {each.shell for each in COMMANDS} <= {"", *SHELL_COMMANDS}
    assert {each.python for each in COMMANDS} <= {"", *gr.__all__}
    assert [each.name for each in COMMANDS if each.run is None and not each.edit] == []


def test_rows_made_from_types_cover_them():
    assert get_args(RenderMode) == RENDER_MODES
    assert get_args(Split) == SPLITS


def test_commands_have_different_names_and_help():
    names = [each.name for each in all_commands()]
    assert len(set(names)) == len(names)
    assert all(help_of(each.name) == each.help != "" for each in COMMANDS)
