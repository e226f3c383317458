"""Whole drives with a client in a process of its own that has the protocol alone."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.simulation.agents.base import SensorRequirements
from gsrain_engine.simulation.agents.http import ClientError
from gsrain_engine.simulation.interop import hugsim_agent
from gsrain_engine.simulation.interop.hugsim_agent import HugsimAgent
from gsrain_engine.simulation.interop.hugsim_protocol import with_hugsim_rig
from gsrain_engine.simulation.simulation import Simulation, run_drive
from simulation import small_drive

CLIENT = Path(__file__).parent / "client.py"


def command(mode):
    return f"{sys.executable} {CLIENT} {{folder}} {mode}"


@pytest.fixture(scope="module")
def renderer():
    with open_renderer("cpu") as opened:
        yield opened


def simulation(renderer, needs, **fields):
    """8 m/s toward a car that stands 18 m ahead."""
    users = [{"id": "lead", "ahead_m": 18.0, "behaviour": {"kind": "constant-velocity"}}]
    test = small_drive.scenario(**{"speed_m_s": 8.0, "duration_s": 2.5, "road_users": users, **fields})
    return Simulation(*with_hugsim_rig(test, small_drive.longer_scene()), needs, renderer)


def driven(renderer, folder, mode):
    """Drive with a client; returns the roll-out and what the client noted."""
    agent = HugsimAgent(folder, command(mode))
    rollout = run_drive(simulation(renderer, agent.needs), agent)
    agent.close()
    return rollout, json.loads((folder / "notes.json").read_text())


def test_a_client_drives_a_whole_scenario_and_receives_its_own_motion_and_images(renderer, tmp_path):
    rollout, notes = driven(renderer, tmp_path, "brake")
    assert (rollout.agent, rollout.end, len(rollout.steps), len(notes)) == ("hugsim", "time", 11, 10)
    assert rollout.steps[-1].ego.speed_m_s < 1  # it braked for the box that it received
    for step, note in zip(rollout.steps[:-1], notes, strict=True):
        assert (note["timestamp"], note["ego_velo"]) == (step.time_s, pytest.approx(step.ego.speed_m_s))
        place = note["ego_pos"][2], note["ego_pos"][0], note["obj_boxes"][0][0]  # z is forward
        assert place == pytest.approx((step.ego.x_m, -step.ego.y_m, step.road_users[0].x_m), abs=1e-9)
    assert notes[0]["ego_rot"] == [0, 0, 0] and notes[-1]["rc"] > notes[0]["rc"]
    bright = notes[-1]["brightness"]
    assert bright.pop("CAM_FRONT") > 20 and bright.pop("CAM_BACK") > 1 and set(bright.values()) == {0}
    assert notes[0]["semantic"] == notes[0]["depth"] == []


def test_none_ends_the_drive(renderer, tmp_path):
    rollout, notes = driven(renderer, tmp_path, "none")
    assert rollout.end == "agent" and len(notes) == 2 and list(rollout.steps[-1].notes) == ["problem"]


@pytest.fixture(scope="module")
def moment(renderer):
    """The rig of a drive and its first observation."""
    simulated = simulation(renderer, SensorRequirements(("all",)))
    return simulated.rig, simulated.reset()


def plans(folder, mode, moment, times=2, **settings):
    """Let a client plan several times for the same moment; returns its plans and notes."""
    agent = HugsimAgent(folder, command(mode), **settings)
    agent.reset(0, moment[0])
    made = [agent.plan(moment[1]) for _ in range(times)]
    agent.close()
    return made, json.loads((folder / "notes.json").read_text())


@pytest.mark.parametrize("mode", ["keep", "list"])
def test_plans_of_all_kinds_are_taken(mode, moment, tmp_path):
    everything = {"semantic": True, "depth": True, "channel_order": "bgr"} if mode == "list" else {}
    made, notes = plans(tmp_path, mode, moment, 1, **everything)
    np.testing.assert_array_equal(made[0].points, [(4.0 * k, 0.0) for k in range(1, 7)])
    assert len(notes[0]["semantic"]) == len(notes[0]["depth"]) == (6 if everything else 0)
    first, _, last = notes[0]["first_pixel"]  # of a sand-colored wall
    assert (first < last) == bool(everything)
    needs = HugsimAgent(tmp_path, semantic=True, depth=True).needs
    assert needs == SensorRequirements(("all",), depth=True, semantic=True)


@pytest.mark.parametrize(
    ("mode", "word"),
    [
        ("die", r"exit code 1, .*output\.txt: 'the engine is out of oil'"),
        ("die-reading", "'there is a hole in the road'"),
        ("garbage", "9 bytes"),
        ("hang", "0.3 s"),
    ],
)
def test_a_failing_client_is_an_error(mode, word, moment, tmp_path):
    with pytest.raises(ClientError, match=word):
        plans(tmp_path, mode, moment, later_wait_s=0.3 if mode == "hang" else 60.0)
    for broken in ("no-such-program-anywhere", "", "zsh 'open"):
        with pytest.raises(ClientError, match="client"):
            HugsimAgent(tmp_path, broken).reset(0, moment[0])


def test_a_client_started_early_drives_the_first_drive(moment, tmp_path):
    agent = HugsimAgent(tmp_path, command("keep"))
    agent.start()
    early = agent.client
    agent.start()
    agent.reset(0, moment[0])
    assert agent.client is early and len(agent.plan(moment[1]).points) == 6
    agent.reset(0, moment[0])  # each drive needs a client of its own
    assert agent.client is not early and len(agent.plan(moment[1]).points) == 6
    agent.close()


def test_a_client_that_ends_before_the_drive_is_an_error(moment, tmp_path, monkeypatch):
    monkeypatch.setattr(hugsim_agent, "_START_S", 60.0)  # a slow machine
    agent = HugsimAgent(tmp_path, f"{sys.executable} {tmp_path}/no_script.py")
    with pytest.raises(ClientError, match=r"ended with exit code 2.*no_script\.py.* as soon as it was started"):
        agent.start()
    with pytest.raises(ClientError, match=r"ended with exit code 2.* before the drive began"):
        agent.reset(0, moment[0])
    agent.close()


def test_a_failing_client_costs_no_images(renderer, tmp_path, monkeypatch):
    agent = HugsimAgent(tmp_path, "no-such-program-anywhere")
    simulated = simulation(renderer, agent.needs)
    monkeypatch.setattr(simulated, "render_cameras", lambda pictures: pytest.fail("an image was drawn"))
    with pytest.raises(ClientError, match="no-such-program-anywhere"):
        run_drive(simulated, agent)


def test_a_client_that_a_person_starts_and_that_hangs_at_the_end_is_logged(moment, tmp_path, caplog):
    agent = HugsimAgent(tmp_path, later_wait_s=0.2)
    client = subprocess.Popen([sys.executable, CLIENT, tmp_path, "deaf"])
    try:
        agent.reset(0, moment[0])
        points = agent.plan(moment[1]).points
        agent.close()
    finally:
        client.kill()
        client.wait()
    assert points[0].tolist() == [4.0, 0.0]
    (warning,) = (each.getMessage() for each in caplog.records if each.levelname == "WARNING")
    assert "0.2 s" in warning
