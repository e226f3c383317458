import msgspec
import pytest
import yaml

from gsrain_engine.simulation.interop.hugsim_scenario import is_hugsim_scenario
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.simulation.simulation import Simulation
from gsrain_engine.simulation.vehicle import HUGSIM_VEHICLE, Control
from small_scene import small_scene

CAR = [2.0, 13.0, -0.3, 0.1, 2.0, "2024_07_05_10_58_02", "ConstantPlanner", {}]


@pytest.fixture
def written(tmp_path):
    def write(*rows, **fields):
        plain = {
            "mode": "easy_00", "plan_list": list(rows), "load_HD_map": False, "start_euler": [0.0, 0.0, 0.0],
            "start_ab": [0.0, 0.0], "start_velo": 1, "start_steer": 0, "scene_name": "scene-0383",
            "iteration": 30000, **fields,
        }  # fmt: skip
        path = tmp_path / "scene-0383-easy-00.yaml"
        path.write_text(yaml.safe_dump(plain))
        return path

    return write


def test_a_vehicle_goes_where_hugsims_planner_takes_it(written):
    # HUGSIM: a (right) -= v sin(yaw) dt, b (forward) += v cos(yaw) dt, from (2, 13): left by the yaw.
    test = load_scenario(written(CAR))
    (car,) = test.road_users
    assert (car.ahead_m, car.left_m) == pytest.approx((13.0, -2.0))
    assert (car.turned_deg, car.speed_m_s) == pytest.approx((5.72958, 2.0), abs=1e-4)
    assert (test.name, test.scene, test.speed_m_s, test.vehicle) == (
        "scene-0383-easy_00",
        "scene-0383",
        1,
        HUGSIM_VEHICLE,
    )
    simulation = Simulation(test, small_scene())
    simulation.reset()
    for _ in range(4):
        simulation.advance(Control(0.0, 0.0))
    (seen,) = simulation.observation().road_users
    # One second later; our x is its forward, our y its -right, and its world begins at the ego vehicle's middle.
    assert (seen.x_m, seen.y_m) == pytest.approx((13 + 2 * 0.995004, -(2 - 2 * 0.0998334)), abs=1e-4)


def test_a_turned_start_turns_everything(written):
    test = load_scenario(written(CAR, start_ab=[1.0, 3.0], start_euler=[0.0, 90.0, 0.0]))
    assert (test.ahead_m, test.left_m, test.turned_deg) == (3.0, -1.0, -90.0)
    (car,) = test.road_users
    # Looking right: what is 1 m to the right is ahead, what is 10 m forward is to the left.
    assert (car.ahead_m, car.left_m, car.turned_deg) == pytest.approx((1.0, 10.0, 95.72958), abs=1e-4)


def test_planners_become_behaviours(written):
    idm = [*CAR[:6], "IDM", {}]
    cycle = [*CAR[:6], "UnicyclePlanner", {"uc_id": "6e29", "speed": 0.6}]
    followed, recorded = (each.behaviour for each in load_scenario(written(idm, cycle)).road_users)
    assert (followed.desired_speed_m_s, followed.least_gap_m, followed.headway_s) == (30, 5, 2)
    assert (recorded.actor, recorded.pace) == ("6e29", 0.6)


@pytest.mark.parametrize(
    ("rows", "fields", "said"),
    [
        (
            [[*CAR[:6], "AttackPlanner", {"best_k": 2}]],
            {},
            "vehicle 1 of plan_list: AttackPlanner .* at random",
        ),
        ([CAR, [*CAR[:6], "Teleporter", {}]], {}, "vehicle 2 of plan_list: planner 'Teleporter' is not known"),
        ([[*CAR[:6], "UnicyclePlanner", {}]], {}, "vehicle 1 of plan_list: .*`actor`"),
        ([[*CAR[:4], -3.0, *CAR[5:]]], {}, "vehicle 1 of plan_list: .*speed_m_s"),
        ([CAR[:4]], {}, "plan_list"),
        ([], {"start_steer": 0.2}, "start_steer 0.2"),
        ([], {"start_euler": [0.0, 0.0, 30.0]}, "only a turn about the second axis"),
        ([], {"start_velo": "fast"}, "start_velo"),
    ],
)
def test_what_cannot_be_taken_is_said(written, rows, fields, said):
    with pytest.raises(ValueError, match=f"scene-0383-easy-00.yaml: .*{said}|scene-0383-easy-00.yaml: {said}"):
        load_scenario(written(*rows, **fields))


def test_hugsims_own_scenarios_are_recognized_and_read(test_data):
    folder = test_data / "closed_loop" / "hugsim" / "configs" / "benchmark" / "nuscenes"
    read = {path.stem: load_scenario(path) for path in sorted(folder.glob("*.yaml")) if "extreme" not in path.stem}
    assert {name: len(each.road_users) for name, each in read.items()} == {
        "scene-0013-easy-00": 1, "scene-0383-easy-00": 0, "scene-0383-hard-00": 2, "scene-0383-medium-00": 1,
    }  # fmt: skip
    with pytest.raises(ValueError, match="AttackPlanner"):
        load_scenario(folder / "scene-0383-extreme-00.yaml")


def test_ours_are_not_hugsims(tmp_path):
    mine = load_scenario("stationary-lead")
    assert not is_hugsim_scenario(msgspec.to_builtins(mine))
    path = tmp_path / "mine.yaml"
    path.write_bytes(msgspec.yaml.encode(mine))
    assert load_scenario(path) == mine
