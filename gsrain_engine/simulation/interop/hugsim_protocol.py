"""HUGSIM's protocol: named pipes, observation and plan messages, its world frame, and its camera rig.

A message on `obs_pipe` or `plan_pipe` has neither length nor version: it ends when the writer closes the pipe.
"""

import errno
import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from jaxtyping import Float64

from ...safe_io.limits import ByteBudget, Deadline, InputError, TooLargeError, open_pipe, read_pipe, write_pipe
from ...safe_io.text_files import printable_line
from ...scene.rigs import driving_rigs
from ...scene.scene import RigCamera, Scene
from ..agents.base import COMMANDS, CameraView, Observation, Rig, front_camera, lidar_to_rig
from ..agents.http import ClientError, plan_points
from ..scenario import Scenario
from ..sensors import camera_of_width, rig_cameras
from ..traffic.base import RoadUser
from ..vehicle import HUGSIM_VEHICLE
from .hugsim_pickle import read_plain_pickle

OBSERVATIONS, PLANS = "obs_pipe", "plan_pipe"
_LONGEST_PAUSE_S = 0.02
_MOMENTS = 25  # number of polls to wait for a client that closed a pipe to end, so that the error names the reason


class Timeouts:
    """Deadline for a client, with a check that it still runs."""

    def __init__(self, seconds: float, ended: Callable[[], str | None]) -> None:
        """Start the deadline; `ended` returns a clause on the client's end, or None while it runs."""
        self.deadline, self._ended = Deadline(seconds), ended

    def check(self, done: str) -> None:
        """Raise ClientError if the deadline has passed or the client ended before it has `done` something."""
        ended = self._ended()
        if ended is not None:
            raise ClientError(f"the client {ended} before it had {done}")
        if not self.deadline.left_s:
            raise self.late(done)

    def late(self, done: str) -> ClientError:
        """Return the error of a client that has not `done` something in time, even partially."""
        return ClientError(f"the client has not {done} within {self.deadline.seconds:g} s")

    def failed(self, done: str, why: str) -> ClientError:
        """Return the error of a client that closed a pipe: its end if it has ended, else `why`."""
        for _ in range(_MOMENTS):
            try:
                self.check(done)
            except ClientError as ended:
                return ended
            time.sleep(_LONGEST_PAUSE_S)
        return ClientError(why)


class Pipes:
    """The pipes in a folder; created if missing, since either side may start first."""

    def __init__(self, folder: Path) -> None:
        """Create missing pipes. Raises ClientError if that fails."""
        if not hasattr(os, "mkfifo"):
            raise ClientError("this system has no named pipes, by which HUGSIM's clients are spoken to")
        folder.mkdir(parents=True, exist_ok=True)
        self._observations, self._plans = folder / OBSERVATIONS, folder / PLANS
        for path in (self._observations, self._plans):
            try:
                os.mkfifo(path)
            except FileExistsError:
                if not path.is_fifo():
                    raise ClientError(f"{path} is there, and it is no pipe: move it away") from None
            except OSError as problem:
                raise ClientError(f"no pipe can be made: {problem}") from None

    def send(self, message: memoryview | bytes, timeouts: Timeouts) -> None:
        """Write a message; returns when all but a pipe buffer has been read. Raises ClientError if it is not read."""
        pipe = self._reached(timeouts)
        try:
            _widen(pipe)
            write_pipe(pipe, message, timeouts.deadline, lambda: timeouts.check("read the observation"))
        except TimeoutError:
            raise timeouts.late("read the observation") from None
        except BrokenPipeError:
            reason = "the client closed obs_pipe before it had read the observation"
            raise timeouts.failed("read the observation", reason) from None
        finally:
            os.close(pipe)

    def receive(self, timeouts: Timeouts, max_bytes: int) -> bytes:
        """Read the client's reply to its end. Raises ClientError if none comes, it is too long, or the client ends."""
        try:
            pipe = open_pipe(self._plans, os.O_RDONLY)
        except OSError as problem:
            raise ClientError(f"the pipe can't be opened: {problem}") from None
        try:
            budget = ByteBudget(max_bytes, self._plans)
            reply = read_pipe(pipe, budget, timeouts.deadline, lambda: timeouts.check("answered"))
        except TimeoutError:
            raise timeouts.late("answered") from None
        except TooLargeError:
            raise ClientError(f"the client answers more than {max_bytes} bytes") from None
        finally:
            os.close(pipe)
        if not reply:
            raise timeouts.failed("answered", "the client opened plan_pipe and closed it without an answer")
        return reply

    def _reached(self, timeouts: Timeouts) -> int:
        """Open for writing once there is a reader, by polling."""
        pause = 0.0005
        while True:
            try:
                return open_pipe(self._observations, os.O_WRONLY)
            except OSError as problem:
                if isinstance(problem, InputError) or problem.errno != errno.ENXIO:
                    raise ClientError(f"the pipe can't be opened: {problem}") from None
            timeouts.check("opened obs_pipe")
            time.sleep(pause)
            pause = min(2 * pause, _LONGEST_PAUSE_S)


def _widen(pipe: int) -> None:
    """Enlarge the pipe buffer if supported; a message is megabytes."""
    import fcntl  # not on Windows, where this module must still import

    if hasattr(fcntl, "F_SETPIPE_SZ"):
        with suppress(OSError):
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, 1 << 20)


# Observation messages: `(obs, info)`, named and shaped as in HUGSIM's environment

ChannelOrder = Literal["rgb", "bgr"]
_UNKNOWN = 19  # the class after Cityscapes' last; HUGSIM's scenes have twenty
_ROUTE_SHARE = 0.9  # route share that HUGSIM counts as complete


def hugsim_obs(
    views: Mapping[str, CameraView], cameras: Mapping[str, RigCamera], channels: ChannelOrder, semantic: bool,
    depth: bool,
) -> dict[str, dict[str, np.ndarray]]:  # fmt: skip
    """Return `obs`: rgb, semantic and depth (meters) by camera; zeros for cameras without an image.

    Outputs that are not sent are empty dictionaries, so that a client that needs them fails with a missing key instead
    of using an invalid image.
    """
    rgb: dict[str, np.ndarray] = {}
    semantics: dict[str, np.ndarray] = {}
    depths: dict[str, np.ndarray] = {}
    for name, camera in cameras.items():
        view, shape = views.get(name), (camera.height, camera.width)
        rgb[name] = np.zeros((*shape, 3), np.uint8) if view is None else view.image
        if channels == "bgr":
            rgb[name] = np.ascontiguousarray(rgb[name][..., ::-1])
        if semantic:
            ids = None if view is None else view.semantic
            semantics[name] = np.zeros(shape, np.uint8) if ids is None else np.minimum(ids, np.uint8(_UNKNOWN))
        if depth:
            depth_m = None if view is None else view.depth_m
            depths[name] = np.zeros(shape, np.float32) if depth_m is None else depth_m
    return {"rgb": rgb, "semantic": semantics, "depth": depths}


Box = list[float]
"""z, -x, -y, width, length, height, yaw: center in axes x forward, y left, z up, yaw left positive (HUGSIM's "IMU")."""


@dataclass(frozen=True, slots=True)
class HugsimWorld:
    """Pose of HUGSIM's world in the simulation's world (z up).

    Axes are those of the front camera at the start (x right, y down, z forward), meters. HUGSIM uses the first recorded
    front camera as mounted; here it is leveled, so that y is straight down and the ego vehicle stays in its x-z plane,
    as HUGSIM's boxes and poses assume.
    """

    x_m: float
    y_m: float
    z_m: float  # x, y and z: position of the front camera at the start
    yaw_rad: float  # heading of the vehicle at the start

    @classmethod
    def from_observation(cls, rig: Rig, observation: Observation) -> "HugsimWorld":
        """Create the world with its origin at the front camera of an observation."""
        return cls(*_front_camera(rig, observation), observation.state.yaw_rad)

    def place(self, x_m: float, y_m: float, z_m: float) -> Float64[np.ndarray, "3"]:
        """Transform a position to HUGSIM's world."""
        cosine, sine = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        forward = cosine * (x_m - self.x_m) + sine * (y_m - self.y_m)
        left = cosine * (y_m - self.y_m) - sine * (x_m - self.x_m)
        return np.array([-left, self.z_m - z_m, forward])

    def yaw(self, yaw_rad: float) -> float:
        """Transform a heading (left positive) to an angle about y down (right positive), -pi..pi."""
        return wrap_to_pi(self.yaw_rad - yaw_rad)

    def ego_place(self, rig: Rig, observation: Observation) -> Float64[np.ndarray, "3"]:
        """Return the position of the front camera, HUGSIM's reference point of the ego vehicle."""
        return self.place(*_front_camera(rig, observation))

    def ego_box(self, rig: Rig, observation: Observation) -> Box:
        """Return the ego vehicle's box: around the center of its body, at the front camera's height."""
        state, vehicle = observation.state, rig.vehicle
        x, y = state.to_world(np.array([[vehicle.middle_m, 0.0]]))[0]
        middle = self.place(float(x), float(y), _front_camera(rig, observation)[2])
        size = vehicle.width_m, vehicle.length_m, vehicle.height_m
        return [*_forward_left_up(middle), *size, -self.yaw(state.yaw_rad)]

    def object_box(self, user: RoadUser) -> Box:
        """Return a road user's box: bottom center, and heading in HUGSIM's form, -yaw - pi/2.

        HUGSIM's models face their own x axis, a quarter turn right of forward: `yaw` is that of the model, -pi..pi.
        """
        bottom = self.place(user.x_m, user.y_m, user.z_m)
        length, width, height = user.size_lwh
        model_yaw = wrap_to_pi(self.yaw(user.yaw_rad) - np.pi / 2)
        return [*_forward_left_up(bottom), width, length, height, -model_yaw - np.pi / 2]


def hugsim_info(
    observation: Observation, rig: Rig, world: HugsimWorld, cameras: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Return `info`; `cameras` are `cam_params`.

    Angles are radians, right positive, but for the boxes' yaw. Two deliberate differences: `ego_rot` stays
    (0, yaw, 0) beyond a quarter turn, where HUGSIM's three angles switch to another triple of the same rotation; and
    every message has `rc` and `collision`, which HUGSIM omits in the first message of a drive.
    """
    state = observation.state
    along = observation.route.nearest(state.x_m, state.y_m).along_m
    return {
        "ego_pos": [float(each) for each in world.ego_place(rig, observation)],
        "ego_rot": [0.0, world.yaw(state.yaw_rad), 0.0],
        "ego_velo": float(state.speed_m_s),
        "ego_steer": -float(state.steer_rad),
        "accelerate": float(observation.acceleration_m_s2),
        "steer_rate": -float(observation.steer_rate_rad_s),
        "timestamp": float(observation.time_s),
        "command": COMMANDS.index(observation.command),
        "ego_box": world.ego_box(rig, observation),
        "obj_boxes": [world.object_box(user) for user in observation.road_users],
        "cam_params": {name: dict(values) for name, values in cameras.items()},
        "rc": max(0.0, along) / (_ROUTE_SHARE * observation.route.length_m),
        "collision": False,
    }


def camera_params(cameras: Mapping[str, RigCamera], rig: Rig) -> dict[str, dict[str, Any]]:
    """Return `cam_params`: intrinsics, and poses of the vehicle (v2c) and the lidar (l2c) in each camera (4x4, meters).

    The vehicle's frame is nuScenes' (x forward, y left, z up, below the rear axle on the road), the lidar's is x right,
    y forward, z up. The fields of view encode the focal lengths, W / (2 tan(fovx / 2)), regardless of cx and cy.
    """
    vehicle_to_rig = np.eye(4)
    vehicle_to_rig[2, 3] = -rig.height_m
    lidar = lidar_to_rig(cameras[CAMERA_NAMES[0]])
    params: dict[str, dict[str, Any]] = {}
    for name, camera in cameras.items():
        rig_to_camera = np.linalg.inv(camera.camera_to_ego)
        params[name] = {
            "intrinsic": {
                "H": int(camera.height), "W": int(camera.width), "cx": float(camera.cx), "cy": float(camera.cy),
                "fovx": float(2 * np.arctan(camera.width / (2 * camera.fx))),
                "fovy": float(2 * np.arctan(camera.height / (2 * camera.fy))),
            },
            "v2c": rig_to_camera @ vehicle_to_rig,
            "l2c": rig_to_camera @ lidar,
        }  # fmt: skip
    return params


MAX_BYTES = 1 << 20  # maximum size of a reply; a plan of six points has 200 bytes


def read_reply(data: bytes) -> Float64[np.ndarray, "n 2"] | None:
    """Return a plan's points (x right, y forward, meters, 0.5 s apart); None if the client gives up.

    Accepts numeric arrays and lists of pairs. Raises ClientError for anything else; runs no code of the pickle.
    """
    try:
        value = read_plain_pickle(data)
    except ValueError as problem:
        raise ClientError(f"the client sent {len(data)} bytes that can't be read: {printable_line(problem)}") from None
    return None if value is None else plan_points(value, "the client")


def wrap_to_pi(angle_rad: float) -> float:
    return float(np.arctan2(np.sin(angle_rad), np.cos(angle_rad)))


def _front_camera(rig: Rig, observation: Observation) -> tuple[float, float, float]:
    x, y, z = front_camera(rig.cameras).camera_to_ego[:3, 3]
    world = observation.state.to_world(np.array([[x, y]]))[0]
    return float(world[0]), float(world[1]), float(observation.height_m + rig.height_m + z)


def _forward_left_up(place: Float64[np.ndarray, "3"]) -> tuple[float, float, float]:
    return float(place[2]), -float(place[0]), -float(place[1])


# HUGSIM rig: six cameras of 800 x 450 with nuScenes' names; the ego box is centered on the front camera

CAMERA_NAMES = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")
"""UniAD's and VAD's clients need all six, LTF's the three front ones."""

WIDTH_PX, HEIGHT_PX = 800, 450
"""Clients resize to 1600 x 900 and double the intrinsics, or assume 1920 x 1080; they support no other size."""

RIG = "hugsim"


def with_hugsim_rig(scenario: Scenario, scene: Scene) -> tuple[Scenario, Scene]:
    """Return a scenario and its scene with HUGSIM's vehicle and a rig "hugsim" for its clients.

    HUGSIM steers the position of the front camera, at the center of the ego box. This moves the rig back until its
    front camera is above the vehicle's reference point, so that plans need no conversion. Raises ValueError if the
    scene has no rig with a front camera.
    """
    rigs = list(scene.rigs.values()) if scenario.rig is None else [rig_cameras(scene, scenario.rig)]
    rig = hugsim_rig(max(rigs, key=lambda each: len(_by_name(each)), default=()))
    scenario = msgspec.structs.replace(scenario, vehicle=HUGSIM_VEHICLE, rig=RIG, picture_width_px=WIDTH_PX)
    return scenario, replace(scene, rigs={**scene.rigs, RIG: rig})


def hugsim_rig(cameras: tuple[RigCamera, ...]) -> tuple[RigCamera, ...]:
    """Return the cameras of a rig that HUGSIM's clients use, at their size, with the front one above the origin.

    Images taller than 16:9 are cropped evenly at top and bottom; wider ones show more.
    """
    known = _by_name(cameras)
    if CAMERA_NAMES[0] not in known:
        names = ", ".join(each.name for each in cameras) or "no cameras"
        raise ValueError(f"a rig for HUGSIM's clients needs a camera CAM_FRONT (or FRONT), not only {names}")
    back = -front_camera(tuple(known.values())).camera_to_ego[:3, 3] * (1, 1, 0)
    resized: list[RigCamera] = []
    for name, camera in known.items():
        wide, scale = camera_of_width(_moved(camera, back), WIDTH_PX), WIDTH_PX / camera.width
        cut = (camera.height * scale - HEIGHT_PX) / 2
        resized.append(replace(wide, name=name, height=HEIGHT_PX, cy=wide.cy - cut))
    return tuple(resized)


def six_hugsim_cameras(cameras: tuple[RigCamera, ...]) -> Mapping[str, RigCamera]:
    """Return HUGSIM's six cameras by name: the rig's, and nuScenes' for missing ones, around the same front one.

    Raises ValueError if the rig's cameras have another size.
    """
    own = {each.name: each for each in cameras if each.name in CAMERA_NAMES}
    front = CAMERA_NAMES[0]
    if front not in own:
        raise ValueError(f"HUGSIM's clients need a camera {front}: drive with the rig {RIG!r} of `with_hugsim_rig`")
    for each in own.values():
        if (each.width, each.height) != (WIDTH_PX, HEIGHT_PX):
            raise ValueError(
                f"camera {each.name} is {each.width} x {each.height}: HUGSIM's clients take {WIDTH_PX} x {HEIGHT_PX}"
            )
    nuscenes = {each.name: each for each in hugsim_rig(driving_rigs()["nuscenes"])}
    shift = own[front].camera_to_ego[:3, 3] - nuscenes[front].camera_to_ego[:3, 3]
    return {name: own[name] if name in own else _moved(nuscenes[name], shift) for name in CAMERA_NAMES}


def _by_name(cameras: tuple[RigCamera, ...]) -> dict[str, RigCamera]:
    """Return cameras by nuScenes' names; FRONT_LEFT counts as CAM_FRONT_LEFT."""
    named = {f"CAM_{each.name.upper().removeprefix('CAM_')}": each for each in cameras}
    return {name: named[name] for name in CAMERA_NAMES if name in named}


def _moved(camera: RigCamera, by_m: np.ndarray) -> RigCamera:
    pose = camera.camera_to_ego.copy()
    pose[:3, 3] += by_m
    return replace(camera, camera_to_ego=pose)
