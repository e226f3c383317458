"""Whole drives with a client in a process of its own that knows the protocol and nothing of us."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.simulation.agents.base import Agent, SensorRequirements
from gsrain_engine.simulation.agents.http import ClientError
from gsrain_engine.simulation.interop.hugsim_agent import HugsimAgent
from gsrain_engine.simulation.interop.hugsim_protocol import (
    HugsimWorld,
    camera_params,
    hugsim_info,
    six_hugsim_cameras,
    with_hugsim_rig,
)
from gsrain_engine.simulation.simulation import Simulation, drive
from simulation.interop.road_with_lead import scenario, scene

CLIENT = Path(__file__).parent / "client.py"


def command(mode, python=sys.executable):
    return f"{python} {CLIENT} {{folder}} {mode}"


@pytest.fixture(scope="module")
def renderer():
    with open_renderer("cpu") as opened:
        yield opened


def simulation(renderer, agent, **fields):
    asked, shown = with_hugsim_rig(scenario(**fields), scene())
    return Simulation(asked, shown, agent.needs, renderer)


def driven(renderer, folder, mode, python=sys.executable):
    """Drive with a client; returns the roll-out and what the client noted."""
    agent = HugsimAgent(folder, command(mode, python))
    simulated = simulation(renderer, agent)
    for _ in drive(simulated, agent):
        pass
    agent.close()
    notes = folder / "notes.json"
    return simulated.rollout(agent.name), json.loads(notes.read_text()) if notes.exists() else None


def test_it_is_an_agent(tmp_path):
    agent = HugsimAgent(tmp_path)
    assert isinstance(agent, Agent) and agent.name == "hugsim"
    agent.close()


@pytest.fixture(scope="module")
def whole_drive(renderer, tmp_path_factory):
    return driven(renderer, tmp_path_factory.mktemp("drive"), "brake")


def test_a_client_drives_a_whole_scenario(whole_drive):
    rollout, notes = whole_drive
    assert rollout.end == "time" and len(rollout.steps) == 11
    assert len(notes) == 10  # one for each plan; "Done" was the last
    assert rollout.steps[-1].ego.speed_m_s < 1  # it braked for the box it was told of
    assert not any(step.collision for step in rollout.steps)


def test_the_client_saw_its_own_motion(whole_drive):
    rollout, notes = whole_drive
    for step, note in zip(rollout.steps[:-1], notes, strict=True):
        assert note["timestamp"] == step.time_s
        assert note["ego_velo"] == pytest.approx(step.ego.speed_m_s)
        assert note["ego_pos"][2] == pytest.approx(step.ego.x_m, abs=1e-9)  # z is forward
        assert note["ego_pos"][0] == pytest.approx(-step.ego.y_m, abs=1e-9)
        lead = step.road_users[0]
        assert note["obj_boxes"][0][0] == pytest.approx(lead.x_m, abs=1e-9)
    assert notes[0]["ego_pos"] == pytest.approx([0, 0, 0]) and notes[0]["ego_rot"] == [0, 0, 0]
    assert notes[-1]["rc"] > notes[0]["rc"]


def test_the_client_saw_pictures(whole_drive):
    _, notes = whole_drive
    bright = notes[-1]["brightness"]
    assert bright["CAM_FRONT"] > 20 and bright["CAM_BACK"] > 1
    assert [bright[name] for name in ("CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")] == [
        0
    ] * 4
    assert notes[0]["focal"] == pytest.approx(633.2)
    assert notes[0]["semantic"] == [] and notes[0]["depth"] == []
    red, _, blue = notes[0]["first_pixel"]
    assert red > blue  # a sand-colored wall


def test_twice_is_the_same(whole_drive, renderer, tmp_path):
    again, notes = driven(renderer, tmp_path, "brake")
    assert (again, notes) == whole_drive


def test_numpy_1_drives_just_the_same(whole_drive, renderer, tmp_path):
    python = os.environ.get("GSRAIN_OLD_NUMPY_PYTHON")
    if python is None:
        pytest.skip("no Python with NumPy 1 (set GSRAIN_OLD_NUMPY_PYTHON)")
    rollout, notes = driven(renderer, tmp_path, "brake", python)
    assert notes[0]["numpy"].startswith("1.")
    assert rollout == whole_drive[0]


@pytest.fixture(scope="module")
def moment(renderer, tmp_path_factory):
    """The rig of a drive and its first observation."""
    simulated = simulation(renderer, HugsimAgent(tmp_path_factory.mktemp("moment")))
    return simulated.rig, simulated.reset()


def plans(folder, mode, moment, times=2, **settings):
    """Let a client plan several times for the same moment; returns its plans and what it noted."""
    agent = HugsimAgent(folder, command(mode), **settings)
    rig, observation = moment
    agent.reset(0, rig)
    made = [agent.plan(observation) for _ in range(times)]
    agent.close()
    return made, json.loads((folder / "notes.json").read_text())


@pytest.mark.parametrize("mode", ["keep", "float32", "list"])
def test_plans_of_all_kinds_are_taken(mode, moment, tmp_path):
    made, _ = plans(tmp_path, mode, moment, 1)
    np.testing.assert_array_equal(made[0].points, [(4.0 * k, 0.0) for k in range(1, 7)])


def test_blue_first_and_all_that_hugsim_sends(moment, tmp_path):
    _, notes = plans(tmp_path, "keep", moment, 1, semantic=True, depth=True, channel_order="bgr")
    assert len(notes[0]["semantic"]) == 6 and len(notes[0]["depth"]) == 6
    blue, _, red = notes[0]["first_pixel"]
    assert red > blue


def test_labels_and_depths_are_drawn_when_asked_for(tmp_path):
    assert HugsimAgent(tmp_path).needs == SensorRequirements(("all",))
    assert HugsimAgent(tmp_path, semantic=True, depth=True).needs == SensorRequirements(
        ("all",), depth=True, semantic=True
    )


def test_none_ends_the_drive(renderer, tmp_path):
    rollout, notes = driven(renderer, tmp_path, "none")
    assert rollout.end == "agent" and len(notes) == 2
    assert rollout.steps[-1].notes == {"problem": "the client gave up: it answered None"}


@pytest.mark.parametrize(
    ("mode", "why"),
    [
        ("die", r"ended with exit code 1, its last words in .*output\.txt: 'the engine is out of oil'"),
        ("die-reading", "'there is a hole in the road', before it had read the observation"),
        ("garbage", "19 bytes that can't be read"),
        ("evil", "which is not let in"),
        ("shape", r"shape \(6, 1\), not \(N, 2\)"),
        ("nan", "not finite"),
    ],
)
def test_a_failing_client_is_an_error_with_a_sentence(mode, why, moment, tmp_path):
    with pytest.raises(ClientError, match=why):
        plans(tmp_path, mode, moment)
    assert not (tmp_path / "evil-ran").exists()


def test_a_silent_client_is_not_waited_for_for_ever(moment, tmp_path):
    with pytest.raises(ClientError, match=r"has not answered within 0\.3 s"):
        plans(tmp_path, "hang", moment, later_wait_s=0.3)


def test_a_failing_client_leaves_what_was_driven(renderer, tmp_path):
    agent = HugsimAgent(tmp_path, command("die"))
    simulated = simulation(renderer, agent)
    with pytest.raises(ClientError, match="out of oil"):
        for _ in drive(simulated, agent):
            pass
    agent.close()
    rollout = simulated.rollout(agent.name)
    assert (rollout.end, len(rollout.steps)) == ("stopped", 2)


def test_a_command_that_is_none(moment, tmp_path):
    agent = HugsimAgent(tmp_path, "no-such-program-anywhere")
    with pytest.raises(ClientError, match="can't be started"):
        agent.reset(0, moment[0])
    for broken, why in (("", "is empty"), ("zsh 'open", "can't be read")):
        with pytest.raises(ClientError, match=why):
            HugsimAgent(tmp_path, broken).reset(0, moment[0])


def test_a_person_starts_the_client(renderer, tmp_path):
    """Either side may come first."""
    agent = HugsimAgent(tmp_path)
    client = subprocess.Popen([sys.executable, CLIENT, tmp_path])
    simulated = simulation(renderer, agent, duration_s=0.5)
    steps = sum(1 for _ in drive(simulated, agent))
    agent.close()
    assert client.wait(60) == 0
    assert len(json.loads((tmp_path / "notes.json").read_text())) == steps == 2


def test_each_drive_takes_a_new_client(moment, tmp_path):
    """The folder comes last where the command does not say where."""
    agent = HugsimAgent(tmp_path, f"{sys.executable} {CLIENT}")
    rig, observation = moment
    for _ in range(2):
        agent.reset(0, rig)
        agent.plan(observation)
    agent.close()
    assert len(json.loads((tmp_path / "notes.json").read_text())) == 1
    with pytest.raises(ClientError, match="reset the agent first"):
        agent.plan(observation)


def test_a_box_lies_on_the_car_in_the_picture(renderer):
    """From `obj_boxes` over the ego's pose and the lidar into the front picture, as stacks reckon."""
    turned, shown = with_hugsim_rig(scenario(left_m=0.7), scene())
    simulated = Simulation(turned, shown, SensorRequirements(("CAM_FRONT",), semantic=True), renderer)
    rig, observation = simulated.rig, simulated.reset()
    world = HugsimWorld(-3.0, 2.0, 1.0, 0.3)  # wherever it began
    info = hugsim_info(observation, rig, world, camera_params(six_hugsim_cameras(rig.cameras), rig))
    box, yaw = info["obj_boxes"][0], -info["ego_rot"][1]
    away = np.array(box[:3]) + (0, 0, box[5]) - (info["ego_pos"][2], -info["ego_pos"][0], -info["ego_pos"][1])
    forward, left = np.cos(yaw) * away[0] + np.sin(yaw) * away[1], np.cos(yaw) * away[1] - np.sin(yaw) * away[0]
    front = info["cam_params"]["CAM_FRONT"]
    camera_in_lidar = np.linalg.inv(front["l2c"])[:3, 3]
    seen = front["l2c"] @ [*(np.array([-left, forward, away[2]]) + camera_in_lidar), 1.0]
    inner = front["intrinsic"]
    column = inner["cx"] + seen[0] / seen[2] * inner["W"] / (2 * np.tan(inner["fovx"] / 2))
    row = inner["cy"] + seen[1] / seen[2] * inner["H"] / (2 * np.tan(inner["fovy"] / 2))
    instances = observation.views["CAM_FRONT"].instances
    rows, columns = np.nonzero(instances)
    assert instances[int(row) + 8, int(column)] == 1  # below its roof: the first road user
    assert abs(column - columns.mean()) < 5 and abs(row - rows.min()) < 5


def test_a_client_that_does_not_come_for_done_is_told_of_and_stopped(moment, tmp_path, caplog):
    agent = HugsimAgent(tmp_path, command("deaf"), later_wait_s=0.2)
    agent.reset(0, moment[0])
    agent.plan(moment[1])
    agent.close()
    assert caplog.messages == ["the drive is over, but the client has not opened obs_pipe within 0.2 s"]


def test_ctrl_c_does_not_wait_for_a_client(moment, tmp_path, monkeypatch):
    def pressed(*_):
        raise KeyboardInterrupt

    agent = HugsimAgent(tmp_path, command("hang"))
    agent.reset(0, moment[0])
    client = agent._client
    monkeypatch.setattr("gsrain_engine.simulation.interop.hugsim_protocol.Pipes.receive", pressed)
    with pytest.raises(KeyboardInterrupt):
        agent.plan(moment[1])
    assert client.ended is not None
    agent.close()
