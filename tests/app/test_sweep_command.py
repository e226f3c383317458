"""`gsrain sweep` as a person types it."""

import csv
import io
import json

import pytest

from app.main import BAD_INPUT, run
from app.sweep import SOME_FAILED
from gsrain_engine import trusted_code
from sweep.small_sweep import write_road, write_scenario


@pytest.fixture
def sweep(tmp_path):
    scenario = write_scenario(tmp_path / "short.yaml", write_road(tmp_path / "road"))
    file = tmp_path / "sweep.yaml"
    file.write_text(
        f"kind: drive\nscenarios: [{scenario}]\nintensities_mm_h: [0, 8.5]\nseeds: 2\n"
        f"agents: [constant-velocity, oracle-idm]\njitter: {{ahead_m: 1.0}}\noutput: {tmp_path / 'out'}\n"
    )
    return file


def table(folder):
    with (folder / "table.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_it_writes_tables_and_goes_on_where_it_was(sweep, tmp_path, capsys):
    numbers = tmp_path / "numbers.json"
    assert run(["sweep", str(sweep), "--workers", "0", "--json", str(numbers)]) == 0
    told = json.loads(numbers.read_text())
    assert (told["jobs"], told["done"], told["kept"], told["failed"]) == (8, 8, 0, 0)
    assert {cell["agent"]: cell["runs"] for cell in told["cells"]} == {"constant-velocity": 2, "oracle-idm": 2}
    shown = capsys.readouterr().out
    assert "oracle-idm" in shown and "8 of 8 jobs finished, 0 failed" in shown
    out = tmp_path / "out"
    assert len(table(out)) == 8 and (out / "table.parquet").is_file()
    assert (out / "figures" / "short-road.png").is_file()
    page = (out / "report.html").read_text()
    assert "Wilson" in page and "constant-velocity" in page
    before = {name: (out / name).read_bytes() for name in ("table.csv", "table.parquet", "summary.json")}
    assert run(["sweep", str(sweep), "--workers", "0", "--json", str(numbers)]) == 0
    told = json.loads(numbers.read_text())
    assert (told["done"], told["kept"]) == (0, 8)
    assert {name: (out / name).read_bytes() for name in before} == before


def test_shares_make_one_table(sweep, tmp_path, capsys):
    assert run(["sweep", str(sweep), "--workers", "0", "--shard", "1/2"]) == 0
    assert "share 1/2 is done" in capsys.readouterr().out
    out = tmp_path / "out"
    assert not (out / "table.csv").exists() and len(list((out / "rows").iterdir())) == 4
    assert run(["sweep", str(sweep), "--summarize-only"]) == 0
    assert "4 of 8 jobs finished" in capsys.readouterr().out
    assert run(["sweep", str(sweep), "--workers", "0", "--shard", "2/2"]) == 0  # the last one makes it
    assert len(table(out)) == 8


def test_a_failure_is_said_and_done_again_when_asked(sweep, tmp_path, capsys):
    scenario = tmp_path / "short.yaml"
    scenario.write_text(scenario.read_text().replace("id: lead", "id: lead\n  model: absent.ply"))
    assert run(["sweep", str(sweep), "--workers", "0"]) == SOME_FAILED
    assert "8 x model absent.ply: no such file" in capsys.readouterr().out
    assert {row["status"] for row in table(tmp_path / "out")} == {"failed"}
    assert run(["sweep", str(sweep), "--workers", "0"]) == SOME_FAILED
    assert len((tmp_path / "out" / "log.jsonl").read_text().splitlines()) == 8
    assert run(["sweep", str(sweep), "--workers", "0", "--retry-failed"]) == SOME_FAILED
    assert len((tmp_path / "out" / "log.jsonl").read_text().splitlines()) == 16


def test_ctrl_c_says_how_it_goes_on(sweep, tmp_path, capsys, monkeypatch):
    from app import sweep as command

    def stopped(work):
        for _ in range(4):
            next(work)
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "run_with_progress", stopped)
    assert run(["sweep", str(sweep), "--workers", "0"]) == command.INTERRUPTED
    assert "stopped with 5 jobs to do; the same command goes on from there" in capsys.readouterr().err
    assert not (tmp_path / "out" / "table.csv").exists()


_DRIVER = """
from pathlib import Path
from gsrain_engine.simulation.agents.base import ConstantVelocityAgent

class Mine(ConstantVelocityAgent):
    name = "mine"
    def plan(self, observation):
        Path(__file__).with_name("ran").touch()
        return super().plan(observation)
"""


@pytest.fixture
def with_code(sweep, tmp_path, monkeypatch):
    """A sweep that names a Python file near it, and an empty memory of answers."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr(trusted_code, "TRUSTED", set())
    (tmp_path / "mine.py").write_text(_DRIVER)
    sweep.write_text(sweep.read_text().replace("[constant-velocity, oracle-idm]", "['mine.py:Mine']"))
    return sweep


class _Terminal(io.StringIO):
    def isatty(self):
        return True


def _answer(monkeypatch, words):
    monkeypatch.setattr("sys.stdin", _Terminal(f"{words}\n"))
    asked = _Terminal()
    monkeypatch.setattr("sys.stderr", asked)
    return asked


def test_code_that_a_sweep_names_does_not_run_unasked(with_code, tmp_path, capsys, monkeypatch):
    command = ["sweep", str(with_code), "--workers", "0"]
    assert run(command) == BAD_INPUT
    told = capsys.readouterr().err
    assert "names Python code" in told and "mine.py (SHA-256" in told and "--trust" in told
    asked = _answer(monkeypatch, "")  # Enter is no
    assert run(command) == BAD_INPUT
    assert "mine.py (SHA-256" in asked.getvalue() and "[y/N]" in asked.getvalue()
    assert not (tmp_path / "ran").exists() and not (tmp_path / "out").exists()


def test_trust_is_for_one_run(with_code, tmp_path, monkeypatch):
    command = ["sweep", str(with_code), "--workers", "0"]
    assert run([*command, "--trust"]) == 0
    assert (tmp_path / "ran").exists() and len(table(tmp_path / "out")) == 4
    monkeypatch.setattr(trusted_code, "TRUSTED", set())  # another process
    assert run(command) == 0  # nothing is left to do, so nothing has to be allowed
    assert run([*command, "-o", str(tmp_path / "other")]) == BAD_INPUT


def test_an_answer_holds_for_this_content(with_code, tmp_path, monkeypatch):
    _answer(monkeypatch, "yes")
    assert run(["sweep", str(with_code), "--workers", "0", "--shard", "1/2"]) == 0
    monkeypatch.undo()
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr(trusted_code, "TRUSTED", set())
    assert run(["sweep", str(with_code), "--workers", "0", "--shard", "2/2"]) == 0
    assert len(table(tmp_path / "out")) == 4
    (tmp_path / "mine.py").write_text(_DRIVER + "# changed\n")
    monkeypatch.setattr(trusted_code, "TRUSTED", set())
    assert run(["sweep", str(with_code), "--workers", "0"]) == BAD_INPUT
