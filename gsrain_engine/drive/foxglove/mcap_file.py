"""Roll-outs as MCAP files that Foxglove opens: frames, boxes, planned points, numbers to plot, camera pictures."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from jaxtyping import UInt8

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.scene.camera import Camera

from ..metrics.time_to_collision import gaps_m, times_to_collision_s
from ..road.route import Route
from ..rollouts.rollout import Rollout, RolloutStep
from ..rollouts.run_setting import RunSetting, run_setting
from . import messages as messages
from . import schemas as schemas

_MISSING = "MCAP files need mcap: pip install 'gsrain[drive]'"
_CHUNK_BYTES = 1 << 20
_LIBRARY = "gsrain"


class CameraPicture(NamedTuple):
    """What a camera of the rig saw at a moment."""

    step: int
    name: str
    """Of the camera; it is a frame and a topic."""
    image: UInt8[np.ndarray, "h w 3"]
    """RGB, as a screen shows it."""
    camera: Camera
    """In the world."""


def write_rollout_mcap(
    path: Path, rollout: Rollout, route: Route | None = None, pictures: Iterable[CameraPicture] = ()
) -> None:
    """Write a roll-out for Foxglove; the file is whole or not there at all, and the same input gives the same bytes.

    Times are those of the simulation, from 0. Topics: /tf, /ego/pose, /ego/box, /ego/motion (speed, acceleration, TTC,
    gap and more), /road_users, /plan, /route, /log and for each camera /camera/NAME/image and /camera/NAME/calibration.
    The file's metadata say what was driven. `pictures` come in the order of steps and are taken as they are needed, so
    that they may be drawn on the way.

    Raises ImportError, with what to install, where mcap is missing; ValueError for a picture of a step that there is
    not.
    """
    try:
        from mcap.writer import CompressionType, Writer
    except ModuleNotFoundError:
        raise ImportError(_MISSING) from None
    with whole_file(path) as beside, beside.open("wb") as stream:
        writer = Writer(stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(library=_LIBRARY)
        _Recording(writer, rollout, route).write(iter(pictures))
        writer.finish()


class _Recording:
    def __init__(self, writer: Any, rollout: Rollout, route: Route | None) -> None:
        self._writer, self._rollout, self._route = writer, rollout, route
        self._setting: RunSetting = run_setting(rollout)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._here: set[str] = set()

    def write(self, pictures: Iterator[CameraPicture]) -> None:
        self._writer.add_metadata("gsrain.rollout", self._about())
        times, gaps = times_to_collision_s(self._rollout), gaps_m(self._rollout)
        waiting = next(pictures, None)
        for step, ttc, gap in zip(self._rollout.steps, times, gaps, strict=True):
            self._moment(step, float(ttc), float(gap))
            while waiting is not None and waiting.step == step.step:
                self._picture(step, waiting)
                waiting = next(pictures, None)
        if waiting is not None:
            first, last = self._rollout.steps[0].step, self._rollout.steps[-1].step
            raise ValueError(f"picture of step {waiting.step}: expected rising steps within {first}..{last}")

    def _moment(self, step: RolloutStep, ttc_s: float, gap_m: float) -> None:
        setting, first = self._setting, step is self._rollout.steps[0]
        self._add(step, "/tf", schemas.FRAME_TRANSFORM, messages.ego_transform(step))
        self._add(step, "/ego/pose", schemas.POSE_IN_FRAME, messages.ego_pose_in_world(step))
        self._add(step, "/ego/box", schemas.SCENE_UPDATE, messages.ego_box_update(step, setting.vehicle))
        self._add(step, "/ego/motion", schemas.MOTION, self._motion(step, ttc_s, gap_m))
        here = {user.id for user in step.road_users}
        users = messages.road_users_update(step, self._rollout.users, sorted(self._here - here))
        self._here = here
        self._add(step, "/road_users", schemas.SCENE_UPDATE, users)
        self._add(step, "/plan", schemas.SCENE_UPDATE, messages.plan_update(step))
        if first and self._route is not None:
            self._add(step, "/route", schemas.SCENE_UPDATE, messages.route_update(step, self._route.points))
        for level, text in self._said(step):
            self._add(step, "/log", schemas.LOG, messages.log_message(step.time_s, level, text))

    def _picture(self, step: RolloutStep, picture: CameraPicture) -> None:
        time_s, name, camera = step.time_s, picture.name, picture.camera
        self._add(step, "/tf", schemas.FRAME_TRANSFORM, messages.camera_transform(time_s, name, camera))
        calibration = messages.camera_calibration(time_s, name, camera)
        self._add(step, f"/camera/{name}/calibration", schemas.CAMERA_CALIBRATION, calibration)
        image = messages.compressed_image(time_s, name, picture.image)
        self._add(step, f"/camera/{name}/image", schemas.COMPRESSED_IMAGE, image)

    def _motion(self, step: RolloutStep, ttc_s: float, gap_m: float) -> messages.Message:
        ego = step.ego
        motion = {
            "timestamp": messages.stamp(step.time_s), "speed_m_s": ego.speed_m_s,
            "acceleration_m_s2": ego.acceleration_m_s2, "steer_rad": ego.steer_rad,
            "yaw_rate_rad_s": ego.yaw_rate_rad_s, "ttc_s": ttc_s, "route_left_m": step.route_left_m,
            "route_completion": step.route_completion, "intensity_mm_h": self._setting.intensity_mm_h,
        }  # fmt: skip
        return {**motion, "gap_m": gap_m} if np.isfinite(gap_m) else motion

    def _said(self, step: RolloutStep) -> list[tuple[int, str]]:
        lines: list[tuple[int, str]] = []
        if step is self._rollout.steps[0]:
            rain, agent = self._setting.intensity_mm_h, self._rollout.agent
            lines.append((messages.INFORMATION, f"{self._setting.scenario}: {agent} drives in {rain:g} mm/h"))
        if step.collision is not None:
            lines.append((messages.ERROR, f"collision with {step.collision} at {step.ego.speed_m_s:.2f} m/s"))
        if step is self._rollout.steps[-1]:
            lines.append((messages.INFORMATION, f"end: {self._rollout.end}"))
        return lines

    def _about(self) -> dict[str, str]:
        rollout = self._rollout
        return {
            "scenario": msgspec.json.encode(rollout.scenario, order="sorted").decode(), "scene": rollout.scene,
            "scene_hash": rollout.scene_hash, "agent": rollout.agent, "seed": str(rollout.seed), "end": rollout.end,
            **{f"version of {name}": version for name, version in sorted(rollout.software.items())},
        }  # fmt: skip

    def _add(self, step: RolloutStep, topic: str, schema: schemas.Schema, message: messages.Message) -> None:
        time_ns = messages.nanoseconds_of(step.time_s)
        data = msgspec.json.encode(message)
        self._writer.add_message(self._channel(topic, schema), time_ns, data, time_ns, sequence=step.step)

    def _channel(self, topic: str, schema: schemas.Schema) -> int:
        if topic not in self._channels:
            title = schema["title"]
            if title not in self._schemas:
                data = msgspec.json.encode(schema)
                self._schemas[title] = self._writer.register_schema(title, "jsonschema", data)
            self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[title])
        return self._channels[topic]
