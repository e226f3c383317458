"""Roll-outs as Parquet: without loss, the same bytes, and readable by others."""

import sys

import pytest
from msgspec.structs import replace

from gsrain_engine.simulation.rollout_io import (
    read_any_rollout,
    read_rollout_parquet,
    write_rollout,
    write_rollout_parquet,
)
from small_rollout import approach

pytest.importorskip("pyarrow")


def _noted():
    run = approach(moments=20)
    first = replace(run.steps[0], notes={"seen": [1, 2.5, None], "why": "büschel"}, route_left_m=0.1 + 0.2)
    return replace(run, steps=(first, *run.steps[1:]), software={"gsrain": "1"})


def test_files_are_told_apart_by_their_endings(tmp_path):
    write_rollout_parquet(tmp_path / "run.parquet", _noted())
    write_rollout(tmp_path / "run.jsonl", _noted())
    for file in (tmp_path / "run.parquet", tmp_path / "run.jsonl"):
        assert read_any_rollout(file) == _noted()
    (tmp_path / "run.jsonl").rename(tmp_path / "wrong.parquet")
    with pytest.raises(ValueError, match=r"wrong\.parquet: not a Parquet file"):
        read_any_rollout(tmp_path / "wrong.parquet")


def test_there_and_back(tmp_path):
    write_rollout_parquet(tmp_path / "run.parquet", _noted())
    assert read_rollout_parquet(tmp_path / "run.parquet") == _noted()


def test_the_same_run_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write_rollout_parquet(tmp_path / name, _noted())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_row_is_a_moment(tmp_path):
    from pyarrow import parquet

    run = _noted()
    write_rollout_parquet(tmp_path / "run.parquet", run)
    rows = parquet.read_table(tmp_path / "run.parquet").to_pylist()
    assert [row["time_s"] for row in rows] == [step.time_s for step in run.steps]
    assert rows[1]["ego_x_m"] == 2.5 and rows[1]["ego_speed_m_s"] == 10.0
    assert rows[0]["plan"][0] == {"x_m": 5.0, "y_m": 0.0} and rows[-1]["plan"] == []
    assert rows[0]["road_users"][0]["id"] == "lead" and rows[-1]["collision"] == "lead"


def test_other_files_are_refused_by_name(tmp_path):
    import pyarrow
    from pyarrow import parquet

    (tmp_path / "text").write_text("no")
    with pytest.raises(ValueError, match="text: not a Parquet file"):
        read_rollout_parquet(tmp_path / "text")
    parquet.write_table(pyarrow.table({"a": [1]}), tmp_path / "other")
    with pytest.raises(ValueError, match="other: a Parquet file, but not of a roll-out"):
        read_rollout_parquet(tmp_path / "other")
    write_rollout_parquet(tmp_path / "newer", replace(_noted(), version=2))
    with pytest.raises(ValueError, match="newer: a roll-out of version 2"):
        read_rollout_parquet(tmp_path / "newer")


def test_without_pyarrow_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ImportError, match=r"pip install 'gsrain\[drive\]'"):
        write_rollout_parquet(tmp_path / "run.parquet", _noted())
    assert not (tmp_path / "run.parquet").exists()
