"""`gsrain drive` on a small scene: what it writes, twice the same bytes, and failures of agents."""

import json
from dataclasses import replace

import av
import numpy as np
import pytest

from app.main import BAD_INPUT, run
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.scene import Layer
from gsrain_engine.simulation.interop import hugsim_agent
from gsrain_engine.simulation.rollout_io import read_rollout
from small_scene import patch, small_scene

LEAD = """
name: standing
scene: {scene}
picture_width_px: 96
speed_m_s: 2.0
rain: {{intensity_mm_h: 8.5}}
road_users:
  - {{id: lead, model: hatchback, ahead_m: 12.0, behaviour: {{kind: stationary}}}}
duration_s: 6.0
"""
CONTRACT = {
    "collision", "min_ttc_s", "planned_point_collision_rate", "planned_frame_collision_rate", "comfort_executed",
    "comfort_planned", "steps", "agent", "intensity_mm_h",
}  # fmt: skip


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    write_scene(small_scene(), folder / "scene")
    (folder / "standing.yaml").write_text(LEAD.format(scene=folder / "scene"))
    return folder / "standing.yaml"


def drive(*arguments):
    return run(["drive", *map(str, arguments)])


def test_a_driver_who_never_brakes_hits_the_car_and_is_filmed(scenario, tmp_path, capsys):
    for folder in (tmp_path / "once", tmp_path / "twice"):
        options = ("-o", folder, "--fps", 2, "--backend", "cpu", "--json", folder / "numbers.json")
        assert drive(scenario, "--agent", "constant-velocity", *options) == 0
    numbers = json.loads((tmp_path / "once" / "numbers.json").read_text())
    assert set(numbers) >= CONTRACT
    assert numbers["collision"] and numbers["collided_with"] == "lead" and numbers["min_ttc_s"] == 0
    assert numbers["intensity_mm_h"] == 8.5 and numbers["agent"] == "constant-velocity"
    # 7.675 m from bumper to bumper at 2 m/s: touched in the sixteenth step. Plans reach 6 m: from the fifth on into it.
    assert numbers["steps"] == numbers["frames"] == 16 and numbers["collision_time_s"] == 4.0
    assert numbers["planned_frame_collision_rate"] == pytest.approx(12 / 16)
    name = "standing_constant-velocity_8.5mm_seed0"
    rollout = read_rollout(tmp_path / "once" / f"{name}.jsonl")
    assert rollout.end == "collision" and len(rollout.steps) == 17
    with av.open(str(tmp_path / "once" / f"{name}.mp4")) as film:
        assert sum(1 for _ in film.decode(video=0)) == 11  # 4 s at 2 a second, the last moment, and a second of it
    for file in (f"{name}.jsonl", f"{name}.mp4", "table.csv", "table.md", "standing_constant-velocity.png"):
        assert (tmp_path / "once" / file).read_bytes() == (tmp_path / "twice" / file).read_bytes(), file
    assert "Driving in rain: standing" in (tmp_path / "once" / "report.html").read_text()
    assert "standing" in capsys.readouterr().out


def test_an_oracle_stops_at_every_intensity(scenario, tmp_path, reported):
    options = ("--rain", "0,1.2,12", "--export", "parquet", "-o", tmp_path)
    rows = reported("drive", scenario, "--agent", "oracle-idm", *options)["rows"]
    assert [row["intensity_mm_h"] for row in rows] == [0, 1.2, 12]
    assert not any(row["collision"] for row in rows) and len({row["min_ttc_s"] for row in rows}) == 1
    for ending in ("jsonl", "parquet"):
        assert (tmp_path / f"standing_oracle-idm_12mm_seed0.{ending}").stat().st_size > 1000
    assert not list(tmp_path.glob("*.mp4"))
    assert "| standing | oracle-idm | 0 | no |" in (tmp_path / "table.md").read_text()


@pytest.mark.parametrize(("client", "words"), [("no-such-program", "no-such-program"), ("false", "exit code 1")])
def test_a_client_that_can_not_start_is_refused_before_the_scene_is_read(
    client, words, scenario, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("gsrain_engine.scene.open.load_sorted_scene", lambda scene: pytest.fail("the scene was read"))
    monkeypatch.setattr("gsrain_engine.scene.open.scene_hash", lambda scene: pytest.fail("the scene was read"))
    monkeypatch.setattr(hugsim_agent, "_START_S", 60.0)  # a slow machine
    folders = ("-o", tmp_path / "out", "--hugsim-dir", tmp_path / "pipes")
    assert drive(scenario, *folders, "--hugsim-client", client) == BAD_INPUT
    (error,) = capsys.readouterr().err.strip().splitlines()
    assert words in error and "client" in error and not (tmp_path / "out").exists()


def test_a_drive_without_a_step_writes_nothing_but_its_reason(scenario, tmp_path, capsys):
    out, pipes = tmp_path / "out", tmp_path / "pipes"
    options = ("-o", out, "--hugsim-dir", pipes, "--hugsim-wait", 0.1, "--rain", "0,8.5", "--backend", "cpu")
    assert drive(scenario, *options) == BAD_INPUT
    printed = capsys.readouterr()
    assert printed.out == "" and not out.exists()
    (error,) = [line for line in printed.err.splitlines() if line.startswith("gsrain: ")]
    assert "0.1 s" in error


def test_a_missing_scene_of_hugsim_names_the_places_searched(tmp_path, capsys, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    file = tmp_path / "scene-0383-easy-00.yaml"
    file.write_text("{mode: easy_00, plan_list: [], scene_name: scene-0383, start_velo: 1}")
    assert drive(file, "--agent", "oracle-idm") == BAD_INPUT
    error = capsys.readouterr().err
    assert f"neither at {tmp_path / 'scene-0383'} nor at {tmp_path / 'here' / 'scene-0383'};" in error
    assert drive(file, "--agent", "oracle-idm", "--scene", "other") == BAD_INPUT
    assert capsys.readouterr().err.startswith("gsrain: other: no such scene")


def test_scenes_without_cameras_and_starts_in_an_obstacle(scenario, tmp_path, capsys):
    scene, asked = small_scene("boxed"), (scenario, "--agent", "oracle-idm", "-o", tmp_path / "out", "--scene")
    write_scene(replace(scene, rigs={}), tmp_path / "blind")
    assert drive(*asked, tmp_path / "blind", "--video") == BAD_INPUT
    assert "--video" in capsys.readouterr().err and not (tmp_path / "out").exists()
    assert drive(*asked, tmp_path / "blind") == 0
    assert (tmp_path / "out" / "table.csv").is_file() and not list((tmp_path / "out").glob("*.mp4"))
    assert "begins inside" not in capsys.readouterr().out
    box = Layer("box", patch((-1, 0, 0.6), np.array([2.0, 0, 0]), np.array([0, 0, 0.8]), 12, (0.5, 0.5, 0.5)))
    write_scene(replace(scene, layers=(*scene.layers, box)), tmp_path / "boxed")
    assert drive(*asked, tmp_path / "boxed", "--no-video") == 0
    assert "The drive begins inside of an obstacle of scene 'boxed'" in capsys.readouterr().out


def test_an_agent_of_a_file_may_fail_in_any_way(scenario, tmp_path, capsys):
    own = tmp_path / "mine.py"
    own.write_text(
        "from gsrain_engine.simulation.agents.base import ConstantVelocityAgent as Shipped\n"
        "class Mine(Shipped):\n"
        "    def plan(self, observation):\n"
        "        return super().plan(observation) if observation.step < 2 else {}[observation.step]\n"
    )
    assert drive(scenario, "--agent", own, "-o", tmp_path, "--no-video") == BAD_INPUT
    assert "agent constant-velocity: KeyError: 2 (mine.py, line 4)" in capsys.readouterr().err
    assert len(read_rollout(tmp_path / "standing_constant-velocity_8.5mm_seed0.jsonl").steps) == 3
    own.write_text(own.read_text().split("    def plan")[0] + "    def reset(self, seed, rig):\n        return 1 / 0\n")
    assert drive(scenario, "--agent", f"{own}:Mine", "-o", tmp_path / "none", "--no-video") == BAD_INPUT
