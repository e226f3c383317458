"""`gsrain sweep`: tables, shares, failures, and permission to run the code that a sweep names."""

import csv
import io
import re
import sys

import pytest

from app.main import BAD_INPUT, run
from app.sweep import INTERRUPTED, SOME_FAILED
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


def test_tables_a_second_run_and_ctrl_c(sweep, tmp_path, reported, capsys, monkeypatch):
    def stopped(work, line_every_s):
        for _ in range(4):
            next(work)
        raise KeyboardInterrupt

    command, out = ("sweep", sweep, "--workers", "0"), tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr("app.sweep.run_with_progress", stopped)
        assert run([*map(str, command)]) == INTERRUPTED
    assert "stopped with 5 jobs to do" in capsys.readouterr().err and not (out / "table.csv").exists()
    report = reported(*command)
    assert (report["jobs"], report["done"], report["kept"], report["failed"]) == (8, 5, 3, 0)
    assert {cell["agent"]: cell["runs"] for cell in report["cells"]} == {"constant-velocity": 2, "oracle-idm": 2}
    printed = capsys.readouterr().out
    assert "oracle-idm" in printed and "8 of 8 jobs finished, 0 failed" in printed
    assert len(table(out)) == 8 and (out / "figures" / "short-road.png").is_file()
    page = (out / "report.html").read_text()
    assert "Wilson" in page and "constant-velocity" in page
    before = {name: (out / name).read_bytes() for name in ("table.csv", "table.parquet", "summary.json")}
    report = reported(*command)
    assert (report["done"], report["kept"]) == (0, 8)
    assert {name: (out / name).read_bytes() for name in before} == before


def test_a_pipe_gets_a_line_for_each_drive(sweep, capsys):
    assert run(["sweep", str(sweep), "--workers", "0"]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if " of 8: " in line]
    assert len(lines) == 8
    for number, line in enumerate(lines, start=1):
        assert line.startswith(f"{number / 8:.0%} {number} of 8: ") and "short, " in line
        took = r" \([\d.:]+ (s|min)\)"
        assert re.search(took + (r"; [\d.:]+ (s|min) left$" if number < 8 else "$"), line)


def test_shares_make_one_table(sweep, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(["sweep", str(sweep), "--workers", "0", "--shard", "1/2"]) == 0
    printed = capsys.readouterr().out
    assert f"share 1/2 is done; when all are: gsrain sweep {sweep} -o {out} --summarize-only\n" in printed
    assert not (out / "table.csv").exists() and len(list((out / "rows").iterdir())) == 4
    assert run(["sweep", str(sweep), "--summarize-only"]) == 0 and len(table(out)) == 4
    assert run(["sweep", str(sweep), "--workers", "0", "--shard", "2/2"]) == 0  # the last one makes it
    assert len(table(out)) == 8


def test_programs_and_scripts_of_clients_are_missed_before_the_first_drive(sweep, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("app.sweep._engine", lambda *_: pytest.fail("workers were started"))
    commands = ["no-such-shell tools/e2e.sh 0", f"{sys.executable} tools/drive.py 0"]
    agents = "".join(f"  - {{hugsim: {{command: '{each}'}}, label: a{i}}}\n" for i, each in enumerate(commands))
    text = sweep.read_text()
    start, end = text.index("agents:"), text.index("agents:") + len(text[text.index("agents:") :].splitlines()[0])
    (tmp_path / "clients.yaml").write_text(f"{text[:start]}agents:\n{agents}{text[end:]}")
    assert run(["sweep", "clients.yaml", "--trust", "-o", "out", "--workers", "0"]) == BAD_INPUT
    printed = capsys.readouterr().err
    assert "there is no program no-such-shell" in printed and "there is no script tools/drive.py" in printed
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / "drive.py").touch()
    assert run(["sweep", "clients.yaml", "--trust", "-o", "out", "--workers", "0"]) == BAD_INPUT
    assert "drive.py" not in capsys.readouterr().err


def test_failures_are_rows_and_run_again_when_asked(sweep, tmp_path, capsys):
    scenario = tmp_path / "short.yaml"
    scenario.write_text(scenario.read_text().replace("id: lead", "id: lead\n  model: absent.ply"))
    for options, attempts in ((), 8), ((), 8), (("--retry-failed",), 16):
        assert run(["sweep", str(sweep), "--workers", "0", *options]) == SOME_FAILED
        assert "8 x model absent.ply: no such file" in capsys.readouterr().out
        assert len((tmp_path / "out" / "log.jsonl").read_text().splitlines()) == attempts
    assert {row["status"] for row in table(tmp_path / "out")} == {"failed"}


_DRIVER = """
from pathlib import Path
from gsrain_engine.simulation.agents.base import ConstantVelocityAgent

class Mine(ConstantVelocityAgent):
    name = "mine"
    def plan(self, observation):
        Path(__file__).with_name("ran").touch()
        return super().plan(observation)
"""


class _Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.street
def test_code_that_a_sweep_names_runs_only_when_it_is_allowed(sweep, tmp_path, capsys, monkeypatch):
    (tmp_path / "mine.py").write_text(_DRIVER)
    sweep.write_text(sweep.read_text().replace("[constant-velocity, oracle-idm]", "['mine.py:Mine']"))

    def swept(*options, answer=None):
        """Run the sweep as another process would: in a terminal where something is answered."""
        with monkeypatch.context() as patch:
            patch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
            patch.setattr(trusted_code, "TRUSTED", set())
            asked = _Terminal()
            if answer is not None:
                patch.setattr("sys.stdin", _Terminal(f"{answer}\n"))
                patch.setattr("sys.stderr", asked)
            code = run(["sweep", str(sweep), "--workers", "0", *options])
        return code, asked.getvalue() or capsys.readouterr().err

    for code, printed in (swept(), swept(answer="")):  # Enter is no
        assert code == BAD_INPUT and "mine.py (SHA-256" in printed
    assert "[y/N]" in printed
    assert not (tmp_path / "ran").exists() and not (tmp_path / "out").exists()
    assert swept("--trust")[0] == 0  # for one run
    assert (tmp_path / "ran").exists() and len(table(tmp_path / "out")) == 4
    assert swept()[0] == 0  # nothing is left to do, so nothing has to be allowed
    other = ("-o", str(tmp_path / "other"))
    assert swept(*other)[0] == BAD_INPUT
    assert swept(*other, "--shard", "1/2", answer="yes")[0] == 0
    assert swept(*other, "--shard", "2/2")[0] == 0
    (tmp_path / "mine.py").write_text(_DRIVER + "# changed\n")  # a permission is for the content
    assert swept("-o", str(tmp_path / "third"))[0] == BAD_INPUT
