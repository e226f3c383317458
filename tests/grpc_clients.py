"""A scene with a car, and the ends of calls, for tests of gRPC servers."""

from dataclasses import replace
from threading import Event
from typing import Any

import grpc
import numpy as np
import pytest

from gsrain_engine.scene.scene import Actor, PoseTrack, Scene
from small_scene import patch, small_scene


def scene_with_car() -> Scene:
    """The small scene without its road, whose Gaussians are large, and a red car 12 m ahead, 2 m wide and high."""
    scene = replace(small_scene(), layers=small_scene().layers[1:])
    car = patch((0, -1, 0), np.array([0.0, 2, 0]), np.array([0, 0, 2.0]), 12, (0.9, 0.05, 0.05))
    pose = np.eye(4)
    pose[:3, 3] = 12, 0, 0
    return replace(scene, actors=(Actor("car-7", "car", (4.0, 2.0, 2.0), car, PoseTrack.standing(pose)),))


def wait_for(is_true: Any) -> None:
    """Wait until the server's threads have seen that a client is gone: they look ten times a second."""
    for _ in range(300):
        if is_true():
            return
        Event().wait(0.05)
    raise AssertionError("still not")


def status_of(call: Any) -> str:
    with pytest.raises(grpc.RpcError) as error:
        call()
    details = error.value.details() or ""
    assert "Traceback" not in details and "\n" not in details and len(details) < 300
    return error.value.code().name
