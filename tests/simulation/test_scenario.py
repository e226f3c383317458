"""Scenarios: what is valid, their files and HUGSIM's, where a drive starts, and the shipped ones."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from curved_scene import RADIUS_M, curved_scene
from gsrain_engine.simulation.ground import recorded_route
from gsrain_engine.simulation.interop.hugsim_scenario import VEHICLES_VARIABLE, is_hugsim_scenario
from gsrain_engine.simulation.scenario import Scenario, start_place, start_state
from gsrain_engine.simulation.scenario_io import load_scenario, save_scenario
from gsrain_engine.simulation.simulation import Simulation
from gsrain_engine.simulation.traffic.appearance import vehicle_model
from gsrain_engine.simulation.vehicle import HUGSIM_VEHICLE, Control
from simulation.small_drive import lead, scenario
from small_scene import small_scene

# Files

TEST = """
name: mine
scene: {scene}
rain: {{calibration: {calibration}}}
road_users:
- {{id: a, model: {model}, behaviour: {{kind: stationary}}}}
- {{id: b, model: van/red, behaviour: {{kind: replay, rollout: {rollout}, user: ego}}}}
- {{id: c, model: 'actor:7', behaviour: {{kind: stationary}}}}
"""


def names_in(test):
    """The names of files in a scenario."""
    first, second, third = test.road_users
    return test.scene, test.rain.calibration, first.model, second.behaviour.rollout, second.model, third.model


def test_files_are_named_from_the_scenarios_own_folder_and_shipped_things_by_name(tmp_path, monkeypatch):
    for name in ("tests/cars", "tests/road", "tests/street", "tests/published", "far", "copies"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("cars/a.ply", "rain.yaml", "drive.jsonl"):
        (tmp_path / "tests" / name).write_text("")
    file = tmp_path / "tests/mine.yaml"
    file.write_text(TEST.format(scene="road", calibration="rain.yaml", model="cars/a.ply", rollout="./drive.jsonl"))
    shipped = "van/red", "actor:7"
    monkeypatch.chdir(tmp_path / "tests/cars")
    assert names_in(load_scenario("../mine.yaml"))[0] == "../road"
    assert load_scenario(file).scene == str(tmp_path / "tests/road")
    monkeypatch.chdir(tmp_path)
    found = load_scenario("tests/mine.yaml")
    assert names_in(found) == ("tests/road", "tests/rain.yaml", "tests/cars/a.ply", "tests/drive.jsonl", *shipped)
    for value in (found, msgspec.structs.replace(found, scene="of-hugsim"), Scenario(name="mine")):
        save_scenario(value, Path("copies/copy.yaml"))
        assert load_scenario("copies/copy.yaml") == value
    save_scenario(found, Path("copies/copy.yaml"))
    assert "scene: ../tests/road" in Path("copies/copy.yaml").read_text()
    # Built-in names, those of no file, and those of the working folder are not changed.
    for scene in ("street", "far"):
        file.write_text(TEST.format(scene=scene, calibration="published", model="saloon", rollout="nowhere.jsonl"))
        assert names_in(load_scenario("tests/mine.yaml")) == (scene, "published", "saloon", "nowhere.jsonl", *shipped)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("controller: {kind: ilq}", r"pure-pursuit.*`\$\.controller\.kind`"),
        ("rain: {intensity: 3}", r"`intensity_mm_h`.*`\$\.rain`"),
        ("speed_m_s: .nan", r"`\$\.speed_m_s`"),
        ("speed_m_s: 3\nspeed_m_s: 4", "line 3"),
        ("road_users: [{id: a, behaviour: {kind: idm}}, {id: a, behaviour: {kind: idm}}]", "'a'"),
        ("road_users: [{id: ego, behaviour: {kind: idm}}]", "'ego'"),
        ("road_users: [{id: background, behaviour: {kind: idm}}]", "'background'"),
        *((f"road_users: [{{id: a, behaviour: {{{fields}}}}}]", place) for fields, place in (
            ("kind: brak", r"brake.*`\$\.road_users\[0\]\.behaviour\.kind`"),
            ("kind: brake, sped: 3", r"`sped`.*`\$\.road_users\[0\]\.behaviour`"),
            ("kind: cut-in", "`after_s`"),
            ("kind: track", "`points`"),
            ("kind: track, actor: a, points: [{time_s: 1, ahead_m: 1}]", "`points`"),
            ("kind: track, points: [{time_s: 2, ahead_m: 1}, {time_s: 2, ahead_m: 1}]", "`points`"),
        )),
    ],
)  # fmt: skip
def test_errors_name_the_file_the_field_and_valid_values(text: str, place: str, tmp_path: Path):
    path = tmp_path / "mine.yaml"
    path.write_text(f"name: mine\n{text}\n")
    with pytest.raises(ValueError, match=rf"mine\.yaml: .*{place}"):
        load_scenario(path)


# HUGSIM's scenario files

CAR = [2.0, 13.0, -0.3, 0.1, 2.0, "2024_07_05_10_58_02", "ConstantPlanner", {}]


@pytest.fixture
def written(tmp_path):
    def write(*rows, **fields):
        plain = {"mode": "easy_00", "plan_list": list(rows), "scene_name": "scene-0383", "start_velo": 1, **fields}
        path = tmp_path / "scene-0383-easy-00.yaml"
        path.write_text(yaml.safe_dump(plain))
        return path

    return write


def test_a_vehicle_goes_where_hugsims_planner_takes_it(written):
    """HUGSIM: a (right) -= v sin(yaw) dt, b (forward) += v cos(yaw) dt, from (2, 13): left by the yaw."""
    test = load_scenario(written(CAR))
    (car,) = test.road_users
    assert (car.ahead_m, car.left_m, car.turned_deg, car.speed_m_s) == pytest.approx((13, -2, 5.72958, 2), abs=1e-4)
    assert (test.name, test.scene, test.vehicle) == ("scene-0383-easy_00", "scene-0383", HUGSIM_VEHICLE)
    simulation = Simulation(test, small_scene())
    simulation.reset()
    for _ in range(4):
        simulation.advance(Control(0.0, 0.0))
    (there,) = simulation.observation().road_users
    # One second later; our x is its forward, our y its -right, and its world begins at the ego vehicle's middle.
    assert (there.x_m, there.y_m) == pytest.approx((13 + 2 * 0.995004, -(2 - 2 * 0.0998334)), abs=1e-4)


def test_a_turned_start_turns_everything_and_planners_become_behaviors(written):
    rows = CAR, [*CAR[:6], "IDM", {}], [*CAR[:6], "UnicyclePlanner", {"uc_id": "6e29", "speed": 0.6}]
    test = load_scenario(written(*rows, start_ab=[1.0, 3.0], start_euler=[0.0, 90.0, 0.0]))
    assert (test.ahead_m, test.left_m, test.turned_deg) == (3.0, -1.0, -90.0)
    car, *others = test.road_users
    # Looking right: what is 1 m to the right is ahead, what is 10 m forward is to the left.
    assert (car.ahead_m, car.left_m, car.turned_deg) == pytest.approx((1.0, 10.0, 95.72958), abs=1e-4)
    followed, recorded = (each.behaviour for each in others)
    assert (followed.desired_speed_m_s, followed.least_gap_m, followed.headway_s) == (30, 5, 2)
    assert (recorded.actor, recorded.pace) == ("6e29", 0.6)


SIZE_WLH = 1.8, 4.0, 1.5


@pytest.fixture
def cars(tmp_path, monkeypatch):
    """A made-up 3DRealCar folder with the vehicle of `CAR`: a bar along the roof's middle, from its middle forward."""
    pytest.importorskip("torch")
    from realcar_vehicle import write_vehicle

    monkeypatch.delenv(VEHICLES_VARIABLE, raising=False)
    x, left = np.linspace(0, 1.9, 200), np.linspace(-0.05, 0.05, 200)
    body = np.random.default_rng(4).uniform(-0.5, 0.5, (2000, 3)) * (4.0, 1.5, 1.8)  # x forward, y down, z left
    bar = np.stack([x, np.full(200, -0.76), left], axis=1)
    write_vehicle(tmp_path / "release" / "3DRealCar" / CAR[5], np.concatenate([body, bar]), SIZE_WLH)
    return tmp_path / "release" / "3DRealCar"


@pytest.mark.parametrize("named", ["by the variable", "by realcar_path", "next to the file"])
def test_hugsims_vehicles_are_those_of_3drealcar_in_place_size_and_direction(named, cars, written, monkeypatch, caplog):
    folder = cars
    file = written([*CAR[:3], 0.3, *CAR[4:]])
    if named == "by the variable":
        monkeypatch.setenv(VEHICLES_VARIABLE, str(folder))
    elif named == "next to the file":
        folder = cars.rename(file.parent / "3DRealCar")
    else:
        (file.parent / "hugsim" / "configs" / "benchmark" / "nuscenes").mkdir(parents=True)
        (file.parent / "hugsim" / "configs" / "sim").mkdir()
        base = f"realcar_path: {folder}\nmodel_base: /nowhere\nHD_map: {{path: /nowhere}}\n"
        (file.parent / "hugsim" / "configs" / "sim" / "nuscenes_base.yaml").write_text(base)
        file = file.rename(file.parent / "hugsim" / "configs" / "benchmark" / "nuscenes" / file.name)
    test = load_scenario(file)
    (car,) = test.road_users
    assert Path(car.model) == folder / CAR[5] and not caplog.records

    look = vehicle_model(car.model, small_scene())
    width, length, height = SIZE_WLH
    assert look.size_lwh_m == pytest.approx((length, width, height))
    body, bar = look.gaussians.means[-2200:-200], look.gaussians.means[-200:]
    np.testing.assert_allclose(body.min(axis=0), (-length / 2, -width / 2, 0), atol=0.05)
    np.testing.assert_allclose(body.max(axis=0), (length / 2, width / 2, height), atol=0.05)
    np.testing.assert_allclose(bar[-1], (1.9, 0.05, height), atol=0.05)  # forward and to its left, on the roof

    simulation = Simulation(test, small_scene())
    simulation.reset()
    (there,) = simulation.observation().road_users
    assert there.size_lwh == pytest.approx((length, width, height))
    # Where HUGSIM's matrix puts it: turned by -yaw - 90 degrees about its y axis, at (2, 13) right and forward.
    turn = Rotation.from_euler("y", -0.3 - np.pi / 2).as_matrix()
    right, _, forward = turn @ [1.9, -0.76, 0.05] + [2.0, 0.0, 13.0]
    actor = next(each for each in simulation.scene_now.actors if each.id == there.id)
    drawn = (simulation.scene.scene_to_world @ actor.pose_at(0.0))[:3] @ [*actor.gaussians.means[-1], 1.0]
    assert drawn[:2] == pytest.approx((forward, -right), abs=1e-3)


def test_saloons_replace_vehicles_that_are_not_there_and_one_line_says_so(cars, written, monkeypatch, caplog):
    file = written(CAR, [*CAR[:5], "2024_01_01_00_00_00", *CAR[6:]], [*CAR[:5], "../../etc", *CAR[6:]])
    monkeypatch.setenv(VEHICLES_VARIABLE, str(cars))
    first, *others = load_scenario(file).road_users
    assert Path(first.model) == cars / CAR[5] and [each.model for each in others] == ["saloon", "saloon"]
    (record,) = caplog.records
    assert record.message == (
        f"{file}: saloons replace 2 of 3 vehicles, whose folders (2024_01_01_00_00_00, ../../etc) are not in {cars}; "
        "set GSRAIN_3DREALCAR to the folder of 3DRealCar"
    )


def test_a_vehicle_whose_checkpoint_holds_anything_but_tensors_is_refused(cars, written, monkeypatch, capsys):
    import torch

    class Malicious:
        def __reduce__(self):
            return print, ("this ran",)

    torch.save(Malicious(), cars / CAR[5] / "gs.pth")
    monkeypatch.setenv(VEHICLES_VARIABLE, str(cars))
    with pytest.raises(ValueError, match=r"gs\.pth: no checkpoint of plain tensors"):
        Simulation(load_scenario(written(CAR)), small_scene())
    assert "this ran" not in capsys.readouterr().out


def test_a_vehicle_of_an_odd_size_is_refused(cars):
    (cars / CAR[5] / "wlh.json").write_text("[1.8, 400.0, 1.5]")
    with pytest.raises(ValueError, match=f"{CAR[5]}: 400 x 1.8 x 1.5 m"):
        vehicle_model(str(cars / CAR[5]), small_scene())


@pytest.mark.parametrize(
    ("rows", "fields", "place"),
    [
        ([[*CAR[:6], "AttackPlanner", {"best_k": 2}]], {}, "vehicle 1 of plan_list: AttackPlanner"),
        ([CAR, [*CAR[:6], "Teleporter", {}]], {}, "vehicle 2 of plan_list: planner 'Teleporter'"),
        ([[*CAR[:6], "UnicyclePlanner", {}]], {}, "vehicle 1 of plan_list: .*`actor`"),
        ([[*CAR[:4], -3.0, *CAR[5:]]], {}, "vehicle 1 of plan_list: .*speed_m_s"),
        ([CAR[:4]], {}, ".*plan_list"),
        ([], {"start_steer": 0.2}, "start_steer"),
        ([], {"start_euler": [0.0, 0.0, 30.0]}, "start_euler"),
        ([], {"start_velo": "fast"}, ".*start_velo"),
    ],
)
def test_unsupported_content_of_hugsims_files_is_named(written, rows, fields, place):
    with pytest.raises(ValueError, match=f"scene-0383-easy-00.yaml: {place}"):
        load_scenario(written(*rows, **fields))


def test_hugsims_own_scenarios_are_recognized_and_ours_are_not_hugsims(test_data):
    assert not is_hugsim_scenario(msgspec.to_builtins(load_scenario("stationary-lead")))
    folder = test_data / "closed_loop" / "hugsim" / "configs" / "benchmark" / "nuscenes"
    read = {path.stem: load_scenario(path) for path in sorted(folder.glob("*.yaml")) if "extreme" not in path.stem}
    assert {name: len(each.road_users) for name, each in read.items()} == {
        "scene-0013-easy-00": 1, "scene-0383-easy-00": 0, "scene-0383-hard-00": 2, "scene-0383-medium-00": 1,
    }  # fmt: skip
    with pytest.raises(ValueError, match="AttackPlanner"):
        load_scenario(folder / "scene-0383-extreme-00.yaml")


# Start

SCENE = curved_scene()
ROUTE = recorded_route(SCENE)


def on_the_curve(along_m, left_m=0.0):
    """Place and heading at a distance along the curve."""
    turned, radius = along_m / RADIUS_M, RADIUS_M - left_m
    return radius * np.sin(turned), RADIUS_M - radius * np.cos(turned), turned


def test_a_road_user_is_placed_along_the_route_or_straight_ahead_of_where_the_ego_vehicle_starts():
    test = scenario(road_users=[lead(ahead_m=10.0, left_m=1.0, model="saloon")])
    (along,) = test.road_users
    ahead = test.vehicle.middle_m + 10.0
    assert start_place(along, test, SCENE, ROUTE) == pytest.approx(on_the_curve(ahead, 1.0), abs=0.05)
    turned = scenario(ahead_m=5.0, left_m=2.0, turned_deg=30.0, road_users=msgspec.to_builtins(test.road_users))
    ego = start_state(turned, SCENE, ROUTE)
    straight = msgspec.structs.replace(along, placed="straight", turned_deg=90.0)
    x, y, heading = start_place(straight, turned, SCENE, ROUTE)
    assert (x, y, heading) == pytest.approx((*ego.to_world(np.array([[ahead, 1.0]]))[0], ego.yaw_rad + np.pi / 2))
    simulation = Simulation(msgspec.structs.replace(turned, road_users=(straight,)), SCENE)
    observed = simulation.reset()
    (there,) = observed.road_users
    assert observed.state == ego and (there.x_m, there.y_m, there.yaw_rad) == (x, y, heading)


@pytest.mark.parametrize(
    ("fields", "scene", "word"),
    [
        ({"start_s": 6.0}, small_scene(), "it ends at 5 s"),
        ({"start_s": float("nan")}, small_scene(), "at nan s"),
        ({"ahead_m": 10.0}, small_scene(), "'small'"),
        ({}, replace(small_scene(), ego=None), "no drive"),
        ({"rig": "six"}, small_scene(), "'six', only one"),
        ({"keep": ["bus"]}, small_scene(), "'bus'"),
        ({"road_users": [lead(model="tank")]}, small_scene(), "model tank"),
    ],
)
def test_a_scenario_that_does_not_fit_its_scene_is_refused(fields, scene, word):
    with pytest.raises(ValueError, match=word):
        Simulation(scenario(**fields), scene)
