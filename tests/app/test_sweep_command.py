"""`gsrain sweep` as a person types it."""

import csv
import json

import pytest

from app.command_line import BAD_INPUT, run
from app.commands.sweep import SOME_FAILED
from drive.sweeps.small_sweep import write_road, write_scenario


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


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--shard", "0/2"], "shares are counted from 1 to n, as by sbatch --array=1-2"),
        (["--workers", "2", "--dask", "tcp://127.0.0.1:1"], "--workers and --dask exclude each other"),
        (["--dask-resources", "GPU=1"], "expected --dask ADDRESS with it"),
        (["--workers", "-1"], "--workers -1: must be within 0..4096"),
        (["--summarize-only"], "there are no rows of this sweep yet"),
    ],
)
def test_what_is_wrong_is_one_line(sweep, capsys, options, said):
    assert run(["sweep", str(sweep), *options]) == BAD_INPUT
    error = capsys.readouterr().err
    assert said in error and len(error.splitlines()) == 1


def test_a_sweep_without_a_folder_asks_for_one(sweep, capsys):
    sweep.write_text("".join(line for line in sweep.read_text().splitlines(True) if not line.startswith("output")))
    assert run(["sweep", str(sweep)]) == BAD_INPUT
    assert "expected --output DIR" in capsys.readouterr().err


def test_ctrl_c_says_how_it_goes_on(sweep, tmp_path, capsys, monkeypatch):
    from app.commands import sweep as command

    def stopped(work):
        for _ in range(4):
            next(work)
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "followed", stopped)
    assert run(["sweep", str(sweep), "--workers", "0"]) == command.INTERRUPTED
    assert "stopped with 5 jobs to do; the same command goes on from there" in capsys.readouterr().err
    assert not (tmp_path / "out" / "table.csv").exists()
