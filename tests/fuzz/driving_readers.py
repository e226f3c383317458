"""Rows of the table: scenarios, sweeps, roll-outs, and what other programs answer while they drive."""

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

from gsrain_engine.simulation.agents.http import ClientError, read_plan
from gsrain_engine.simulation.interop.hugsim_protocol import read_reply
from gsrain_engine.simulation.metrics.summary import measure_drive
from gsrain_engine.simulation.rollout_io import read_any_rollout, write_rollout, write_rollout_parquet
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.sweep.results import columns_of, rows_in, rows_parquet
from gsrain_engine.sweep.settings import load_sweep
from small_rollout import approach

from .mutations import damaged_bytes, damaged_json, damaged_text, damaged_yaml
from .reader import Reader, one_file, one_text
from .settings_readers import assert_finite

_SHIPPED = Path(__file__).resolve().parents[2] / "sample_configs"

_SCENARIO = """
name: everybody
scene: street
start_s: 1.5
speed_m_s: 10.0
keep: [neighbour]
rain: {intensity_mm_h: 8.5, seed: 3, wind_m_s: [1.0, -2.0], calibration: published}
vehicle: {length_m: 4.5}
controller: {kind: pure-pursuit}
road_users:
- {id: a, model: van/red, ahead_m: 30.0, speed_m_s: 5.0, behaviour: {kind: constant-velocity}}
- {id: b, model: truck, size_lwh_m: [8.0, 2.5, 3.0], placed: straight, left_m: 3.5, behaviour: {kind: stationary}}
- {id: c, ahead_m: 20.0, behaviour: {kind: idm, desired_speed_m_s: 12.0}}
- {id: d, ahead_m: 25.0, left_m: 3.5, behaviour: {kind: cut-in, gap_m: 12.0, duration_s: 2.0}}
- {id: e, ahead_m: 45.0, speed_m_s: 9.0, behaviour: {kind: brake, after_s: 2.0, deceleration_m_s2: 4.0}}
- {id: f, behaviour: {kind: track, points: [{time_s: 1.0, ahead_m: 3.0}, {time_s: 2.0, ahead_m: 8.0, left_m: 1.0}]}}
- {id: g, behaviour: {kind: replay, rollout: drive.jsonl, user: ego}}
"""
_HUGSIM = {
    "mode": "easy_00", "load_HD_map": False, "start_euler": [0.0, 20.0, 0.0], "start_ab": [1.0, 2.0], "start_velo": 1,
    "start_steer": 0, "scene_name": "scene-0383", "iteration": 30000,
    "plan_list": [
        [2.0, 13.0, -0.3, 0.1, 2.0, "2024_07_05_10_58_02", "ConstantPlanner", {}],
        [1.0, 23.0, -0.3, 0.1, 2.0, "2024", "UnicyclePlanner", {"uc_id": "6e29", "speed": 0.5}],
        [0.0, 33.0, -0.3, 3.1, 2.0, "2024", "IDM", {}],
    ],
}  # fmt: skip


def _read_scenario(path: Path) -> None:
    assert_finite(load_scenario(path))


def _read_rollout(path: Path) -> None:
    rollout = read_any_rollout(path)
    assert rollout.steps, "has no moments"
    assert_finite(rollout)
    try:
        with np.errstate(all="ignore"):
            measure_drive(rollout)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _damaged_json_lines(data: bytes, chance: Any) -> bytes:
    lines = data.splitlines(keepends=True)
    if chance.random() < 0.2:
        return damaged_text(data, chance)
    number = chance.randrange(len(lines))
    lines[number] = damaged_json(lines[number], chance) + b"\n"
    return b"".join(lines)


def _row_parquet() -> bytes:
    samples = {str: "word", int: 3, float: 0.5, bool: True}
    return rows_parquet([{name: samples[kind] for name, kind in columns_of("drive").items()}], "drive")


def _read_rows(path: Path) -> None:
    try:
        assert isinstance(rows_in(path.read_bytes()), list)
    except ValueError as error:  # a folder of rows takes a damaged one for missing
        raise ValueError(f"{path}: {error}") from error.__cause__


def _pickles(protocol: int) -> Callable[[Path], Path]:
    plan = np.arange(12.0).reshape(6, 2)

    def write(folder: Path) -> Path:
        (folder / "array").write_bytes(pickle.dumps(plan, protocol))
        (folder / "list").write_bytes(pickle.dumps([[np.float32(x), y] for x, y in plan.tolist()], protocol))
        (folder / "tensor").write_bytes(pickle.dumps(torch.from_numpy(plan), protocol))
        (folder / "none").write_bytes(pickle.dumps(None, protocol))
        return folder

    return write


def _read_replies(folder: Path) -> None:
    for file in sorted(each for each in folder.iterdir() if each.is_file()):
        try:
            points = read_reply(file.read_bytes())
        except ClientError as error:
            raise ClientError(f"{file}: {error}") from error.__cause__
        assert points is None or (np.isfinite(points).all() and points.shape[1] == 2)


_REPLY = {
    "trajectory": [[2.0, 0.1], [4.0, 0.2], [6.0, 0.3]],
    "aux_outputs": {"objects_in_bev": [[1.0, 2, 4, 2, 0.1]], "object_classes": ["car"], "object_scores": [0.9]},
}


def _read_http(path: Path) -> None:
    assert np.isfinite(read_plan(path.read_bytes(), str(path)).points).all()


_YAML = (("*.yaml", damaged_yaml),)
_PARQUET = (("*.parquet", damaged_bytes),)

DRIVING_READERS = (
    Reader("scenario", one_text("test.yaml", _SCENARIO), _read_scenario, ValueError, _YAML),
    Reader("hugsim-scenario", one_text("test.yaml", yaml.safe_dump(_HUGSIM)), _read_scenario, ValueError, _YAML),
    *(
        Reader(f"{name}-sweep", one_text("sweep.yaml", (_SHIPPED / f"sweeps/{name}.yaml").read_text()),
               lambda path: assert_finite(load_sweep(path)), ValueError, _YAML)
        for name in ("paper", "dataset")
    ),
    Reader("rollout", one_file("a.jsonl", lambda path: write_rollout(path, approach(moments=5))), _read_rollout,
           ValueError, (("*.jsonl", _damaged_json_lines),)),
    Reader("rollout-parquet", one_file("a.parquet", lambda path: write_rollout_parquet(path, approach(moments=5))),
           _read_rollout, ValueError, _PARQUET),
    Reader("sweep-row", one_file("row.parquet", lambda path: path.write_bytes(_row_parquet())), _read_rows, ValueError,
           _PARQUET),
    *(Reader(f"hugsim-reply-{protocol}", _pickles(protocol), _read_replies, ClientError, (("*", damaged_bytes),))
      for protocol in (0, 2, 5)),
    Reader("http-reply", one_text("reply.json", json.dumps(_REPLY)), _read_http, ClientError,
           (("*.json", damaged_json),)),
)  # fmt: skip
"""Readers of scenarios, roll-outs and their configurations."""
