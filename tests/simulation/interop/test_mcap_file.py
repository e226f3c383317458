"""Roll-outs as MCAP: what Foxglove finds in them."""

import base64
import json
import sys

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from gsrain_engine.scene.camera import Camera
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.interop.mcap import CameraImage, write_rollout_mcap
from small_rollout import approach, ego, rollout, step, user

reader = pytest.importorskip("mcap.reader")


def _written(tmp_path, run, **more):
    """Messages of a written file by topic: (schema, time in ns, content); all fit their schemas."""
    write_rollout_mcap(tmp_path / "run.mcap", run, **more)
    topics = {}
    with (tmp_path / "run.mcap").open("rb") as stream:
        for schema, channel, message in reader.make_reader(stream).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            content = json.loads(message.data)
            _check(content, json.loads(schema.data), channel.topic)
            topics.setdefault(channel.topic, []).append((schema.name, message.log_time, content))
    return topics


def _check(value, schema, where):
    """Assert that a value is as a schema says, so far as these schemas go."""
    kinds = {"object": dict, "array": list, "string": str, "boolean": bool, "integer": int, "number": (int, float)}
    if "oneOf" in schema:
        assert value in [each["const"] for each in schema["oneOf"]], where
        return
    assert isinstance(value, kinds[schema["type"]]), where
    if schema["type"] == "object":
        assert set(schema.get("required", ())) <= set(value) <= set(schema["properties"]), where
        for name, each in value.items():
            _check(each, schema["properties"][name], f"{where}.{name}")
    for each in value if schema["type"] == "array" else ():
        _check(each, schema["items"], where)
    if schema["type"] == "array":
        assert schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", 10**9), where


def test_topics_and_their_schemas(tmp_path):
    run = approach(moments=20)
    topics = _written(tmp_path, run, route=Route(np.array([[0.0, 0], [50, 0]])))
    assert {topic: each[0][0] for topic, each in topics.items()} == {
        "/tf": "foxglove.FrameTransform", "/ego/pose": "foxglove.PoseInFrame", "/ego/box": "foxglove.SceneUpdate",
        "/ego/motion": "gsrain.Motion", "/road_users": "foxglove.SceneUpdate", "/plan": "foxglove.SceneUpdate",
        "/route": "foxglove.SceneUpdate", "/log": "foxglove.Log",
    }  # fmt: skip
    assert [time for _, time, _ in topics["/tf"]] == [250_000_000 * i for i in range(len(run.steps))]
    assert topics["/tf"][5][2]["timestamp"] == {"sec": 1, "nsec": 250_000_000}


def test_boxes_stand_where_they_were(tmp_path):
    turned = rollout([step(0, ego(1.0, 2.0, np.pi / 2), [user(9.0, 3.0, 2.0, np.pi / 2)], [(5.0, 1.0)])])
    topics = _written(tmp_path, turned)
    (box,) = topics["/road_users"][0][2]["entities"]
    cube = box["cubes"][0]
    assert box["id"] == "lead" and box["frame_id"] == "world" and box["texts"][0]["text"] == "lead"
    assert cube["pose"]["position"] == {"x": 9.0, "y": 3.0, "z": 0.75}  # its middle, half its height up
    assert cube["size"] == {"x": 4.0, "y": 2.0, "z": 1.5}
    assert cube["pose"]["orientation"]["z"] == pytest.approx(np.sqrt(0.5))
    own = topics["/ego/box"][0][2]["entities"][0]
    assert own["frame_id"] == "ego" and own["cubes"][0]["pose"]["position"]["x"] == 1.0
    frame = topics["/tf"][0][2]
    assert (frame["parent_frame_id"], frame["child_frame_id"]) == ("world", "ego")
    assert frame["translation"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    line = topics["/plan"][0][2]["entities"][0]["lines"][0]["points"]
    assert (line[0]["x"], line[0]["y"]) == (1.0, 2.0)
    assert (line[1]["x"], line[1]["y"]) == (pytest.approx(0.0), pytest.approx(7.0))  # 5 m ahead is +y, 1 m left is -x


def test_numbers_to_plot(tmp_path):
    motion = [each for _, _, each in _written(tmp_path, approach(moments=20, intensity_mm_h=8.5))["/ego/motion"]]
    assert (motion[0]["ttc_s"], motion[0]["gap_m"], motion[0]["speed_m_s"]) == (3.5, 35.0, 10.0)
    assert motion[-1]["ttc_s"] == 0.0 and motion[0]["intensity_mm_h"] == 8.5
    alone = _written(tmp_path, rollout([step(0, ego())]))["/ego/motion"][0][2]
    assert "gap_m" not in alone and alone["ttc_s"] == 10.0


def test_who_goes_is_deleted_and_so_is_the_last_plan(tmp_path):
    both = [user(20.0), user(40.0, id="other")]
    run = rollout([step(0, ego(), both, [(5.0, 0.0)]), step(1, ego(2.5), both[:1])])
    topics = _written(tmp_path, run)
    later = topics["/road_users"][1][2]
    assert [each["id"] for each in later["entities"]] == ["lead"]
    assert [(each["type"], each["id"]) for each in later["deletions"]] == [(0, "other")]
    assert topics["/plan"][1][2]["deletions"][0]["id"] == "plan"


def test_a_collision_is_red_and_logged(tmp_path):
    topics = _written(tmp_path, approach(moments=20))
    reds = [update["entities"][0]["cubes"][0]["color"]["r"] for _, _, update in topics["/road_users"]]
    assert reds[-1] != reds[0] and len(set(reds[:-1])) == 1
    said = [(each["level"], each["message"]) for _, _, each in topics["/log"]]
    assert (4, "collision with lead at 10.00 m/s") in said and said[-1] == (2, "end: collision")


def _picture(index, shade=200):
    pose = np.eye(4)
    pose[:3, 3] = 1.0, 2.0, 3.0
    image = np.zeros((16, 24, 3), np.uint8)
    image[..., 0] = shade
    return CameraImage(index, "FRONT", image, Camera(24, 16, 20.0, 21.0, 12.0, 8.0, np.linalg.inv(pose)))


def test_pictures_come_with_their_cameras(tmp_path):
    topics = _written(tmp_path, approach(moments=5), pictures=(_picture(i) for i in (0, 2)))
    schema, time_ns, image = topics["/camera/FRONT/image"][1]
    assert (schema, time_ns, image["frame_id"], image["format"]) == (
        "foxglove.CompressedImage", 500_000_000, "FRONT", "jpeg",
    )  # fmt: skip
    seen = cv2.imdecode(np.frombuffer(base64.b64decode(image["data"]), np.uint8), cv2.IMREAD_COLOR)
    assert seen.shape == (16, 24, 3) and abs(int(seen[8, 8, 2]) - 200) < 8 and seen[8, 8, 0] < 8  # BGR: red stays red
    intrinsics = topics["/camera/FRONT/calibration"][0][2]
    assert intrinsics["K"] == [20.0, 0.0, 12.0, 0.0, 21.0, 8.0, 0.0, 0.0, 1.0]
    frame = next(each for _, _, each in topics["/tf"] if each["child_frame_id"] == "FRONT")
    assert frame["translation"] == {"x": 1.0, "y": 2.0, "z": 3.0} and frame["rotation"]["w"] == 1.0


@pytest.mark.parametrize("steps", [(99,), (2, 1)])
def test_pictures_of_no_step_are_refused(tmp_path, steps):
    with pytest.raises(ValueError, match=rf"picture of step {steps[-1]}: expected rising steps within 0\.\.4"):
        write_rollout_mcap(tmp_path / "run.mcap", approach(moments=5), pictures=map(_picture, steps))
    assert not (tmp_path / "run.mcap").exists()


def test_the_same_run_gives_the_same_bytes_and_says_what_it_is(tmp_path):
    run = replace(approach(moments=9, seed=4), software={"gsrain": "1"})
    for name in ("a", "b"):
        write_rollout_mcap(tmp_path / name, run, pictures=[_picture(1)])
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    with (tmp_path / "a").open("rb") as stream:
        (about,) = reader.make_reader(stream).iter_metadata()
    assert (about.name, about.metadata["agent"], about.metadata["seed"]) == ("gsrain.rollout", "hand", "4")
    assert json.loads(about.metadata["scenario"])["name"] == "made-up"


def test_without_mcap_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(ImportError, match=r"pip install 'gsrain\[drive\]'"):
        write_rollout_mcap(tmp_path / "run.mcap", approach(moments=5))
