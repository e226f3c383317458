"""OpenSCENARIO XML: valid against its schema, moves as written when read back, and files of others."""

import sys
from importlib import resources
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest
import xmlschema

from app.main import BAD_INPUT, run
from curved_scene import RADIUS_M, curved_scene
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.simulation.scenario_io import load_scenario, save_scenario
from gsrain_engine.simulation.simulation import Simulation
from gsrain_engine.simulation.vehicle import Control, VehicleState
from gsrain_extras.openscenario.writer import write_openscenario
from simulation.small_drive import scene_with_box
from small_scene import small_scene

SCHEMAS = Path(str(resources.files("scenariogeneration"))).parent / "schemas"


def user(id, kind, **fields):
    behaviour = {"kind": kind, **fields.pop("behaviour", {})}
    return {"id": id, "ahead_m": 20.0, "left_m": 3.5, "speed_m_s": 3.0, "behaviour": behaviour, **fields}


USERS = [
    user("standing", "stationary", speed_m_s=0.0, model="van/red", class_name="car"),
    user("rolling", "constant-velocity", ahead_m=-15.0, left_m=0.0),
    user("by time", "cut-in", behaviour={"after_s": 1.5, "duration_s": 2.0, "to_speed_m_s": 1.0}),
    user("by gap", "cut-in", ahead_m=30.0, behaviour={"gap_m": 8.0, "duration_s": 4.0, "offset_m": -2.5}),
    user("by growing gap", "cut-in", ahead_m=10.0, behaviour={"gap_m": 8.0, "offset_m": 3.5}),
    user("by collision", "brake", ahead_m=40.0, behaviour={"time_to_collision_s": 3.0, "deceleration_m_s2": 4.0}),
    user("slower", "brake", ahead_m=50.0, behaviour={"after_s": 0.5, "to_speed_m_s": 2.0}),
    user("followed", "idm", turned_deg=180.0, behaviour={"desired_speed_m_s": 8.0, "headway_s": 1.5}),
    user("tracked", "track", behaviour={"points": [{"time_s": 1.0, "ahead_m": 4.0}, {"time_s": 2.0, "ahead_m": 5.0}]}),
    user("lorry", "stationary", model="truck", class_name="truck", speed_m_s=0.0),
]  # fmt: skip


def scenario(**fields) -> Scenario:
    plain = {
        "name": "all of them", "description": "One of each.", "speed_m_s": 5.0, "duration_s": 6.0, "start_s": 0.25,
        "rain": {"intensity_mm_h": 8.5, "seed": 3, "wind_m_s": [2.0, -1.0]}, "road_users": USERS, **fields,
    }  # fmt: skip
    return msgspec.convert(plain, Scenario)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("xosc") / "all.xosc"
    write_openscenario(path, scenario(), small_scene())
    return path


def test_the_file_and_its_road_are_valid_and_the_same_bytes_each_time(written, tmp_path):
    xmlschema.XMLSchema(str(SCHEMAS / "OpenSCENARIO_1_2.xsd")).validate(str(written))
    xmlschema.XMLSchema(str(SCHEMAS / "opendrive_17_core.xsd")).validate(str(written.with_suffix(".xodr")))
    write_openscenario(tmp_path / "all.xosc", scenario(), small_scene())
    for suffix in (".xosc", ".xodr"):
        assert (tmp_path / f"all{suffix}").read_bytes() == written.with_suffix(suffix).read_bytes()


def test_rain_is_precipitation_in_mm_h(written, tmp_path):
    clear = tmp_path / "clear.xosc"
    write_openscenario(clear, scenario(rain={}, road_users=[]), small_scene())
    for path, kind, intensity, wetness in ((written, "rain", "8.5", "wetWithPuddles"), (clear, "dry", "0.0", "dry")):
        root = ElementTree.parse(path).getroot()
        rain, fog = root.find(".//Precipitation").attrib, root.find(".//Fog")
        assert rain == {"precipitationType": kind, "precipitationIntensity": intensity}
        assert root.find(".//RoadCondition").get("wetness") == wetness
        assert fog is None if kind == "dry" else 1000 < float(fog.get("visualRange")) < 3000
    wind = float(ElementTree.parse(written).getroot().find(".//Wind").get("direction"))
    assert wind == pytest.approx(np.arctan2(-1, 2) + 2 * np.pi)


def test_a_written_scenario_is_read_back_and_moves_alike(written):
    back, mine = load_scenario(written), scenario()
    rest = {"road_users": (), "controller": mine.controller}
    assert msgspec.structs.replace(back, **rest) == msgspec.structs.replace(mine, **rest)
    for one, other in zip(mine.road_users, back.road_users, strict=True):
        assert other.size_lwh_m is not None
        same = msgspec.structs.replace(other, size_lwh_m=None, placed="along-route", turned_deg=abs(other.turned_deg))
        assert same == one or one.id in ("by growing gap", "tracked")  # these have another form than ours
    first, other = _moved(mine), _moved(back)
    for name, path in first.items():
        # A track is sampled step by step: its places agree, speeds between them hardly.
        columns = slice(2) if name == "tracked" else slice(3)
        np.testing.assert_allclose(other[name][:, columns], path[:, columns], atol=1e-5, err_msg=name)


def _moved(test):
    simulation, paths = Simulation(msgspec.structs.replace(test, leave_m=1000.0), small_scene()), {}
    simulation.reset()
    for _ in range(18):
        for each in simulation.observation().road_users:
            paths.setdefault(each.id, []).append((each.x_m, each.y_m, each.speed_m_s))
        if simulation.end is None:
            simulation.advance(Control(-1.0, 0.0))
    assert len(paths) == 10
    return {name: np.array(path) for name, path in paths.items()}


def test_actors_of_the_scene_follow_trajectories_and_stay(tmp_path):
    path = tmp_path / "keep.xosc"
    write_openscenario(path, scenario(keep="all", road_users=[], duration_s=2.0), scene_with_box())
    vertices = list(ElementTree.parse(path).getroot().iter("Vertex"))
    assert [float(each.get("time")) for each in vertices] == list(np.arange(0, 2.01, 0.25))
    places = [float(each.find(".//WorldPosition").get("x")) for each in vertices]
    assert places == pytest.approx([5 + 2 * (t + 0.25) for t in np.arange(0, 2.01, 0.25)])
    assert load_scenario(path).keep == ("box",)


def test_the_road_follows_the_route_without_gaps(tmp_path):
    path = tmp_path / "curved.xosc"
    write_openscenario(path, scenario(road_users=[]), curved_scene())
    pieces = list(ElementTree.parse(path.with_suffix(".xodr")).getroot().iter("geometry"))
    assert 10 < len(pieces) < 40
    powers, places = np.linspace(0, 1, 20)[:, None] ** np.arange(4), []
    for piece in pieces:
        x, y, heading = (float(piece.get(name)) for name in ("x", "y", "hdg"))
        cubic = piece.find("paramPoly3").attrib
        local = np.stack([powers @ [float(cubic[f"{c}{axis}"]) for c in "abcd"] for axis in "UV"], axis=1)
        places.append(VehicleState(x, y, heading).to_world(local))
        assert len(places) == 1 or places[-1][0] == pytest.approx(places[-2][-1], abs=1e-6)
    east, north = np.concatenate(places).T
    inside = (east > 1) & (north < RADIUS_M - 1)
    offsets = np.abs(np.hypot(east, north - RADIUS_M) - RADIUS_M)[inside]
    assert 0 < offsets.max() < 0.15


FOREIGN = """<?xml version="1.0"?>
<OpenSCENARIO>
  <FileHeader revMajor="1" revMinor="1" date="2024-01-01T00:00:00" author="else" description="A cut-in."/>
  <ParameterDeclarations><ParameterDeclaration name="Speed" parameterType="double" value="12.5"/>
  </ParameterDeclarations>
  <Entities>
    <ScenarioObject name="hero"><CatalogReference catalogName="Vehicles" entryName="car_white"/></ScenarioObject>
    <ScenarioObject name="target"><Vehicle name="v" vehicleCategory="{category}">
      <BoundingBox><Center x="1.5" y="0" z="0.8"/><Dimensions width="2" length="5" height="1.6"/></BoundingBox>
    </Vehicle></ScenarioObject>
  </Entities>
  <Storyboard>
    <Init><Actions>
      <GlobalAction><EnvironmentAction><Environment name="e"><Weather>{rain}</Weather></Environment></EnvironmentAction>
      </GlobalAction>
      <Private entityRef="hero">
        <PrivateAction><TeleportAction><Position><LanePosition roadId="1" laneId="-1" s="50"/></Position>
        </TeleportAction></PrivateAction>
        <PrivateAction><LongitudinalAction><SpeedAction><SpeedActionTarget><AbsoluteTargetSpeed value="$Speed"/>
        </SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction>
      </Private>
      <Private entityRef="target">
        <PrivateAction><TeleportAction><Position>{position}</Position></TeleportAction></PrivateAction>
        <PrivateAction><LongitudinalAction><SpeedAction><SpeedActionTarget><AbsoluteTargetSpeed value="10"/>
        </SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction>
      </Private>
    </Actions></Init>
    <Story name="s"><Act name="a">
      <ManeuverGroup name="g"><Actors><EntityRef entityRef="target"/></Actors>
        <Maneuver name="m"><Event name="e"><Action name="x"><PrivateAction>{action}</PrivateAction></Action>
          <StartTrigger><ConditionGroup><Condition name="when" delay="0.5">{condition}</Condition></ConditionGroup>
          </StartTrigger>
        </Event></Maneuver>
      </ManeuverGroup>
    </Act></Story>
  </Storyboard>
</OpenSCENARIO>
"""
PARTS = {
    "category": "van",
    "rain": '<Precipitation precipitationType="rain" precipitationIntensity="4"/>',
    "position": '<RelativeLanePosition entityRef="hero" dLane="1" ds="30" offset="0.2"/>',
    "action": '<LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="sinusoidal" '
    'dynamicsDimension="distance" value="25"/><LaneChangeTarget><RelativeTargetLane entityRef="hero" value="0"/>'
    "</LaneChangeTarget></LaneChangeAction></LateralAction>",
    "condition": '<ByValueCondition><SimulationTimeCondition value="2" rule="greaterThan"/></ByValueCondition>',
}


def foreign(folder, **parts):
    path = folder / "theirs.xosc"
    path.write_text(FOREIGN.format(**{**PARTS, **parts}))
    return path


SPEED = (
    '<LongitudinalAction><SpeedAction><SpeedActionDynamics dynamicsShape="linear" dynamicsDimension="{}" value="{}"/>'
    '<SpeedActionTarget><AbsoluteTargetSpeed value="{}"/></SpeedActionTarget></SpeedAction></LongitudinalAction>'
)


@pytest.mark.parametrize(
    ("dimension", "value", "to", "expected"),
    [
        ("rate", 3, 4, {"deceleration_m_s2": 3.0}),
        ("time", 4, 4, {"deceleration_m_s2": 1.5}),
        ("distance", 21, 4, {"deceleration_m_s2": 2.0}),
        ("rate", 1, 15, {"offset_m": 0.0, "acceleration_m_s2": 1.0}),  # speeding up stays in the lane
    ],
)
def test_a_file_of_somebody_else_is_read(tmp_path, dimension, value, to, expected):
    test = load_scenario(foreign(tmp_path))
    (target,) = test.road_users
    assert (test.name, test.speed_m_s, test.rain.intensity_mm_h) == ("theirs", 12.5, 4.0)
    assert (target.placed, target.model, target.size_lwh_m) == ("along-route", "van", (5, 2, 1.6))
    assert (target.ahead_m, target.left_m) == pytest.approx((30 + 1.5 - test.vehicle.middle_m, 3.7))
    cut_in = target.behaviour
    assert (cut_in.after_s, cut_in.duration_s, cut_in.offset_m) == (2.5, 2.5, None)
    (changing,) = load_scenario(foreign(tmp_path, action=SPEED.format(dimension, value, to))).road_users
    assert changing.behaviour.to_speed_m_s == to
    assert {name: getattr(changing.behaviour, name) for name in expected} == pytest.approx(expected)


@pytest.mark.parametrize(
    ("parts", "word"),
    [
        ({"position": '<LanePosition roadId="1" laneId="1" s="80"/>'}, "target .*LanePosition"),
        ({"position": '<WorldPosition x="1" y="2"/>'}, "hero a LanePosition"),
        ({"category": "bicycle"}, '"gsrain.model"'),
        ({"swapped": {'<Private entityRef="target">': '<Private entityRef="nobody">'}}, "target"),
        ({"swapped": {'<AbsoluteTargetSpeed value="10"/>': "<RelativeTargetSpeed/>"}}, "AbsoluteTargetSpeed"),
        ({"rain": '<Precipitation precipitationType="snow" precipitationIntensity="1"/>'}, "snow"),
        ({"rain": '<Precipitation precipitationType="rain" intensity="0.4"/>'}, "precipitationIntensity"),
        ({"rain": PARTS["rain"].replace('"4"', '"$Rain"')}, "Rain"),
        ({"rain": "</Weather></Environment></EnvironmentAction></GlobalAction><GlobalAction><EnvironmentAction>"
                  '<Environment name="later"><Weather>'}, "weather"),
        ({"action": "<LateralAction><LaneOffsetAction/></LateralAction>"}, "LateralAction: .*LaneChangeAction"),
        ({"action": PARTS["action"].replace('Ref="hero"', 'Ref="other"')}, "RelativeTargetLane .*hero"),
        ({"action": PARTS["action"].replace('"25"', '"far"')}, 'LaneChangeActionDynamics@value is "far"'),
        ({"action": PARTS["action"].replace('"distance"', '"jerk"')}, "'jerk'"),
        ({"action": SPEED.format("rate", 1, 4).replace("AbsoluteT", "RelativeT")}, "AbsoluteTargetSpeed"),
        ({"action": "<RoutingAction><FollowTrajectoryAction/></RoutingAction>"}, "target: .*trajectory"),
        ({"condition": PARTS["condition"] + "</Condition></ConditionGroup><ConditionGroup><Condition>"}, "groups"),
        ({"condition": "<ByEntityCondition><EntityCondition><SpeedCondition/></EntityCondition></ByEntityCondition>"},
         "'when'"),
        ({"condition": PARTS["condition"] + '</Condition><Condition><TimeToCollisionCondition value="1"/>'},
         "several conditions"),
    ],
)  # fmt: skip
def test_unsupported_content_is_named(tmp_path, parts, word):
    path = foreign(tmp_path, **parts)
    for old, new in parts.get("swapped", {}).items():
        path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ValueError, match=f"theirs.xosc: .*{word}"):
        load_scenario(path)


BOMB = (
    '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;"><!ENTITY c SYSTEM "file:///etc/passwd">]>'
    "<OpenSCENARIO><Storyboard>&b;&c;</Storyboard></OpenSCENARIO>"
)
EMPTY = "<OpenSCENARIO><Storyboard/></OpenSCENARIO>"


@pytest.mark.parametrize("text", ["", "<OpenSCENARIO>", "<OpenSCENARIO/>", "<Catalog/>", "no XML", BOMB, EMPTY])
def test_other_files_are_refused_and_entities_are_not_expanded(tmp_path, text):
    path = tmp_path / "none.xosc"
    path.write_text(text)
    named = {BOMB: "a document type", "<OpenSCENARIO/>": ".*Storyboard", "<Catalog/>": ".*Storyboard"}
    with pytest.raises(ValueError, match=f"none.xosc: {named.get(text, '')}"):
        load_scenario(path)


# The command


@pytest.fixture
def standing(tmp_path):
    """Return a scenario file whose scene is small."""
    write_scene(small_scene(), tmp_path / "scene")
    save_scenario(scenario(scene=str(tmp_path / "scene"), road_users=[], duration_s=1.0), tmp_path / "standing.yaml")
    return tmp_path / "standing.yaml"


def test_drives_are_exported_with_their_road_and_read_back(standing, tmp_path, capsys):
    options = ["--agent", "constant-velocity", "--no-video", "-o", str(tmp_path / "out")]
    assert run(["drive", str(standing), "--export", "xosc", *options]) == 0
    printed = [line.strip() for line in capsys.readouterr().out.splitlines()]
    (file,) = (tmp_path / "out").glob("*.xosc")
    assert file.name in printed and file.with_suffix(".xodr").name in printed
    assert file.with_suffix(".xodr").name in file.read_text()
    again = load_scenario(file)
    assert (again.speed_m_s, again.rain.intensity_mm_h, again.duration_s) == (5.0, 8.5, 1.0)
    assert run(["drive", str(file), *options]) == 0


def test_without_its_package_nothing_is_driven(standing, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "scenariogeneration", None)
    assert run(["drive", str(standing), "--export", "xosc", "-o", str(tmp_path / "out")]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("gsrain: --export xosc needs scenariogeneration, which is not installed: ")
    assert line.endswith("'gsrain[drive]'") and not (tmp_path / "out").exists()


def test_the_reader_needs_no_package(written, monkeypatch):
    monkeypatch.setitem(sys.modules, "scenariogeneration", None)
    assert load_scenario(written).speed_m_s == 5.0
