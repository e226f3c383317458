"""Roll-outs as MCAP: contents that fit their schemas, places, colors and camera images, and the same bytes."""

import base64
import json
import sys

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from gsrain_engine.scene.camera import Camera
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.interop.mcap import write_rollout_mcap
from gsrain_engine.simulation.rollout import CameraImage
from small_rollout import approach, ego, rollout, step, user

reader = pytest.importorskip("mcap.reader")


def messages(tmp_path, run, **more):
    """Messages of a written file by topic: (schema, time in ns, content); all fit their schemas."""
    write_rollout_mcap(tmp_path / "run.mcap", run, **more)
    topics = {}
    with (tmp_path / "run.mcap").open("rb") as stream:
        for schema, channel, message in reader.make_reader(stream).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            content = json.loads(message.data)
            check(content, json.loads(schema.data), channel.topic)
            topics.setdefault(channel.topic, []).append((schema.name, message.log_time, content))
    return topics


def check(value, schema, where):
    """Assert that a value is as a schema says, so far as these schemas go."""
    if "oneOf" in schema:
        assert value in [each["const"] for each in schema["oneOf"]], where
        return
    kinds = {"object": dict, "array": list, "string": str, "boolean": bool, "integer": int, "number": (int, float)}
    assert isinstance(value, kinds[schema["type"]]), where
    if schema["type"] == "object":
        assert set(schema.get("required", ())) <= set(value) <= set(schema["properties"]), where
        for name, each in value.items():
            check(each, schema["properties"][name], f"{where}.{name}")
    if schema["type"] == "array":
        assert schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", 10**9), where
        for each in value:
            check(each, schema["items"], where)


def test_topics_schemas_times_and_numbers_to_plot(tmp_path):
    run = approach(moments=20, intensity_mm_h=8.5)
    topics = messages(tmp_path, run, route=Route(np.array([[0.0, 0], [50, 0]])))
    assert {topic: each[0][0] for topic, each in topics.items()} == {
        "/tf": "foxglove.FrameTransform", "/ego/pose": "foxglove.PoseInFrame", "/ego/box": "foxglove.SceneUpdate",
        "/ego/motion": "gsrain.Motion", "/road_users": "foxglove.SceneUpdate", "/plan": "foxglove.SceneUpdate",
        "/route": "foxglove.SceneUpdate", "/log": "foxglove.Log",
    }  # fmt: skip
    assert [time for _, time, _ in topics["/tf"]] == [250_000_000 * i for i in range(len(run.steps))]
    assert topics["/tf"][5][2]["timestamp"] == {"sec": 1, "nsec": 250_000_000}
    first, *_, last = (each for _, _, each in topics["/ego/motion"])
    assert (first["ttc_s"], first["gap_m"], first["speed_m_s"], first["intensity_mm_h"]) == (3.5, 35.0, 10.0, 8.5)
    reds = [update["entities"][0]["cubes"][0]["color"]["r"] for _, _, update in topics["/road_users"]]
    assert last["ttc_s"] == 0.0 and reds[-1] != reds[0] and len(set(reds[:-1])) == 1  # a collision
    lines = [(each["level"], each["message"]) for _, _, each in topics["/log"]]
    assert (4, "collision with lead at 10.00 m/s") in lines and lines[-1] == (2, "end: collision")


def test_boxes_stand_where_they_were_and_others_are_deleted(tmp_path):
    both = [user(9.0, 3.0, 2.0, np.pi / 2), user(40.0, id="other")]
    first = step(0, ego(1.0, 2.0, np.pi / 2), both, [(5.0, 1.0)])
    topics = messages(tmp_path, rollout([first, step(1, ego(2.5), both[:1])]))
    box = topics["/road_users"][0][2]["entities"][0]
    cube = box["cubes"][0]
    assert (box["id"], box["frame_id"], box["texts"][0]["text"]) == ("lead", "world", "lead")
    turn = {"x": 0.0, "y": 0.0, "z": pytest.approx(np.sqrt(0.5)), "w": pytest.approx(np.sqrt(0.5))}
    assert cube["pose"] == {"position": {"x": 9.0, "y": 3.0, "z": 0.75}, "orientation": turn}
    assert cube["size"] == {"x": 4.0, "y": 2.0, "z": 1.5}
    own = topics["/ego/box"][0][2]["entities"][0]
    assert own["frame_id"] == "ego" and own["cubes"][0]["pose"]["position"]["x"] == 1.0
    frame = topics["/tf"][0][2]
    assert (frame["child_frame_id"], frame["translation"]) == ("ego", {"x": 1.0, "y": 2.0, "z": 0.0})
    places = [(each["x"], each["y"]) for each in topics["/plan"][0][2]["entities"][0]["lines"][0]["points"]]
    np.testing.assert_allclose(places, [(1.0, 2.0), (0.0, 7.0)], atol=1e-12)  # 5 m ahead is +y, 1 m left is -x
    later = topics["/road_users"][1][2]
    assert [each["id"] for each in later["entities"]] == ["lead"]
    assert [(each["type"], each["id"]) for each in later["deletions"]] == [(0, "other")]
    assert topics["/plan"][1][2]["deletions"][0]["id"] == "plan"


def camera_image(index):
    pose = np.eye(4)
    pose[:3, 3] = 1.0, 2.0, 3.0
    image = np.zeros((16, 24, 3), np.uint8)
    image[..., 0] = 200
    return CameraImage(index, "FRONT", image, Camera(24, 16, 20.0, 21.0, 12.0, 8.0, np.linalg.inv(pose)))


def test_images_come_with_their_cameras_and_the_same_run_gives_the_same_bytes(tmp_path, monkeypatch):
    run = replace(approach(moments=5, seed=4), software={"gsrain": "1"})
    topics = messages(tmp_path, run, pictures=map(camera_image, (0, 2)))
    schema, time_ns, image = topics["/camera/FRONT/image"][1]
    assert (schema, time_ns, image["frame_id"]) == ("foxglove.CompressedImage", 500_000_000, "FRONT")
    decoded = cv2.imdecode(np.frombuffer(base64.b64decode(image["data"]), np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_allclose(decoded, np.broadcast_to([0, 0, 200], (16, 24, 3)), atol=8)  # BGR: red stays red
    assert topics["/camera/FRONT/calibration"][0][2]["K"] == [20.0, 0.0, 12.0, 0.0, 21.0, 8.0, 0.0, 0.0, 1.0]
    frame = next(each for _, _, each in topics["/tf"] if each["child_frame_id"] == "FRONT")
    assert frame["translation"] == {"x": 1.0, "y": 2.0, "z": 3.0} and frame["rotation"]["w"] == 1.0
    write_rollout_mcap(tmp_path / "again.mcap", run, pictures=map(camera_image, (0, 2)))
    assert (tmp_path / "again.mcap").read_bytes() == (tmp_path / "run.mcap").read_bytes()
    with (tmp_path / "run.mcap").open("rb") as stream:
        (about,) = reader.make_reader(stream).iter_metadata()
    assert (about.name, about.metadata["agent"], about.metadata["seed"]) == ("gsrain.rollout", "hand", "4")
    for steps in ((99,), (2, 1)):
        with pytest.raises(ValueError, match=rf"step {steps[-1]}"):
            write_rollout_mcap(tmp_path / "other.mcap", run, pictures=map(camera_image, steps))
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(ImportError, match=r"gsrain\[drive\]"):
        write_rollout_mcap(tmp_path / "other.mcap", run)
    assert not (tmp_path / "other.mcap").exists()
