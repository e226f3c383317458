"""Roll-outs as JSON lines and Parquet: without loss, the same bytes, and damage refused with its place."""

import sys

import pytest
from msgspec.structs import replace

from gsrain_engine.simulation.rollout_io import read_any_rollout, read_rollout, write_rollout, write_rollout_parquet
from small_rollout import approach

pyarrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")


@pytest.fixture(scope="module")
def run():
    found = approach(moments=20)
    first = replace(found.steps[0], notes={"seen": [1, 2.5, None], "why": "büschel"}, route_left_m=0.1 + 0.2)
    return replace(found, steps=(first, *found.steps[1:]), software={"gsrain": "1"})


WRITERS = {"jsonl": write_rollout, "parquet": write_rollout_parquet}


@pytest.mark.parametrize("suffix", WRITERS)
def test_there_and_back_and_the_same_bytes(run, suffix, tmp_path):
    files = [tmp_path / f"{name}.{suffix}" for name in "ab"]
    for file in files:
        WRITERS[suffix](file, run)
        assert read_any_rollout(file) == run
    assert files[0].read_bytes() == files[1].read_bytes()


def test_a_parquet_row_is_a_step(run, tmp_path):
    write_rollout_parquet(tmp_path / "run.parquet", run)
    rows = parquet.read_table(tmp_path / "run.parquet").to_pylist()
    assert [row["time_s"] for row in rows] == [step.time_s for step in run.steps]
    assert rows[1]["ego_x_m"] == 2.5 and rows[1]["ego_speed_m_s"] == 10.0
    assert rows[0]["plan"][0] == {"x_m": 5.0, "y_m": 0.0} and rows[-1]["plan"] == []
    assert rows[0]["road_users"][0]["id"] == "lead" and rows[-1]["collision"] == "lead"


@pytest.mark.parametrize(
    ("damage", "place"),
    [
        (lambda lines: lines[:-1], "15 moments, 14"),
        (lambda lines: [*lines[:2], *lines[3:]], "15 moments, 14"),
        (lambda lines: [*lines[:-1], lines[-1][:40]], "line 16"),
        (lambda lines: lines[:1], "no moment"),
        (lambda lines: [], "first line"),
        (lambda lines: [b"{}", *lines[1:]], "`version`"),
        (lambda lines: [lines[0].replace(b'"version":1', b'"version":2'), *lines[1:]], "version 2"),
        (lambda lines: [lines[0].replace(b'"seed":0', b'"seed":"a"'), *lines[1:]], r"line 1: .*`\$.seed`"),
        (lambda lines: [lines[0].replace(b'"lead":{', b'"other":{'), *lines[1:]], "step 0: .*'lead'"),
    ],
)
def test_damaged_lines_are_refused(run, damage, place, tmp_path):
    file = tmp_path / "run.jsonl"
    write_rollout(file, run)
    file.write_bytes(b"\n".join(damage(file.read_bytes().splitlines())) + b"\n")
    with pytest.raises(ValueError, match=f"run.jsonl: .*{place}"):
        read_rollout(file)


def test_other_parquet_files_are_refused(run, tmp_path, monkeypatch):
    (tmp_path / "text.parquet").write_text("no")
    parquet.write_table(pyarrow.table({"a": [1]}), tmp_path / "other.parquet")
    write_rollout_parquet(tmp_path / "newer.parquet", replace(run, version=2))
    write_rollout_parquet(tmp_path / "empty.parquet", replace(run, steps=()))
    write_rollout_parquet(tmp_path / "user.parquet", replace(run, users={}))
    for name, word in (("text", ""), ("other", "gsrain.rollout"), ("newer", "version 2"), ("empty", "no moment"),
                       ("user", "'lead'")):  # fmt: skip
        with pytest.raises(ValueError, match=rf"{name}\.parquet: .*{word}"):
            read_any_rollout(tmp_path / f"{name}.parquet")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ImportError, match=r"gsrain\[drive\]"):
        write_rollout_parquet(tmp_path / "none.parquet", run)
    with pytest.raises(ValueError, match=r"newer\.parquet: .*gsrain\[drive\]"):
        read_any_rollout(tmp_path / "newer.parquet")
