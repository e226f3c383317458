"""Files that a scenario names are found beside it, wherever the program was started."""

from pathlib import Path

import msgspec
import pytest

from gsrain_engine.scene.formats.registry import write_gaussians
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.simulation.scenario_io import load_scenario, save_scenario
from gsrain_engine.simulation.traffic.appearance import built_in_vehicle, vehicle_model
from small_scene import small_scene

TEST = """
name: mine
scene: {scene}
rain: {{calibration: {calibration}}}
road_users:
- {{id: a, model: {model}, behaviour: {{kind: stationary}}}}
- {{id: b, model: van/red, behaviour: {{kind: replay, rollout: {rollout}, user: ego}}}}
- {{id: c, model: 'actor:7', behaviour: {{kind: stationary}}}}
"""


@pytest.fixture
def beside(tmp_path: Path) -> Path:
    """A folder with a scenario and all that it names, in another folder than the working one."""
    folder = tmp_path / "tests"
    (folder / "cars").mkdir(parents=True)
    (folder / "road").mkdir()
    write_gaussians(built_in_vehicle("saloon").gaussians, folder / "cars/a.ply")
    for name in ("rain.yaml", "drive.jsonl"):
        (folder / name).write_text("")
    text = TEST.format(scene="road", calibration="rain.yaml", model="cars/a.ply", rollout="./drive.jsonl")
    (folder / "mine.yaml").write_text(text)
    return folder


def test_names_count_from_the_scenarios_own_folder(beside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    found = load_scenario("tests/mine.yaml")
    assert found.scene == "tests/road" and found.rain.calibration == "tests/rain.yaml"
    first, second, third = found.road_users
    assert first.model == "tests/cars/a.ply" and vehicle_model(first.model, small_scene()).size_lwh_m[0] > 1
    assert (second.model, second.behaviour.rollout, third.model) == ("van/red", "tests/drive.jsonl", "actor:7")
    monkeypatch.chdir(beside / "cars")
    assert load_scenario("../mine.yaml").scene == "../road"
    assert load_scenario(beside / "mine.yaml").scene == str(beside / "road")


def test_names_that_are_built_in_or_nowhere_stay(beside: Path, monkeypatch: pytest.MonkeyPatch):
    (beside / "street").mkdir()
    (beside / "published").mkdir()
    text = TEST.format(scene="street", calibration="published", model="saloon", rollout="nowhere.jsonl")
    (beside / "mine.yaml").write_text(text)
    found = load_scenario(beside / "mine.yaml")
    assert (found.scene, found.rain.calibration, found.road_users[0].model) == ("street", "published", "saloon")
    assert found.road_users[1].behaviour.rollout == "nowhere.jsonl"


def test_what_lies_in_the_working_folder_is_found_too(beside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "far").mkdir()
    text = TEST.format(scene="far", calibration="published", model="van", rollout="r.jsonl")
    (beside / "mine.yaml").write_text(text)
    assert load_scenario("tests/mine.yaml").scene == "far"


def test_saved_elsewhere_it_names_the_same_files(beside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    found = load_scenario("tests/mine.yaml")
    Path("copies").mkdir()
    save_scenario(found, Path("copies/copy.yaml"))
    assert "scene: ../tests/road" in Path("copies/copy.yaml").read_text()
    assert load_scenario("copies/copy.yaml") == found
    gone = msgspec.structs.replace(found, scene="of-hugsim")
    save_scenario(gone, Path("copies/copy.yaml"))
    assert load_scenario("copies/copy.yaml") == gone


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("road_users: [{id: a, behaviour: {kind: brak}}]",
         r"'brak', expected constant-velocity, stationary, idm, cut-in, brake, track, replay - at "
         r"`\$\.road_users\[0\]\.behaviour\.kind`"),
        ("controller: {kind: ilq}", r"'ilq', expected ilqr, pure-pursuit - at `\$\.controller\.kind`"),
        ("rain: {intensity: 3}", r"unknown field `intensity`; did you mean `intensity_mm_h`\? "
         r"valid: intensity_mm_h, .*wetness.* - at `\$\.rain`"),
        ("road_users: [{id: a, behaviour: {kind: brake, sped: 3}}]",
         r"unknown field `sped`; valid: kind, .*deceleration_m_s2, to_speed_m_s - at `\$\.road_users\[0\]\.behaviour`"),
        ("speed_m_s: .nan", r"Expected a finite number, got nan - at `\$\.speed_m_s`"),
        ("speed_m_s: 3\nspeed_m_s: 4", "'speed_m_s' is there twice, line 3"),
    ],
)  # fmt: skip
def test_errors_say_what_would_be_right(text: str, why: str, tmp_path: Path):
    path = tmp_path / "mine.yaml"
    path.write_text(f"name: mine\n{text}\n")
    with pytest.raises(ValueError, match=rf"mine\.yaml: .*{why}"):
        load_scenario(path)


def test_a_scenario_is_a_value(tmp_path: Path):
    save_scenario(Scenario(name="mine"), tmp_path / "mine.yaml")
    assert load_scenario(tmp_path / "mine.yaml") == Scenario(name="mine")
