"""Virtual lidar of a roll-out, in its scene and rain."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from ..evaluation.lidar.scan import ROOF_M, RainyScan, scan_in_rain, scan_scene
from ..evaluation.lidar.sensor import LidarSensor
from ..rain.simulation import RainSimulation
from ..render.view import leveled_frame
from ..water.spray import spray_of
from .playback import RolloutPlayback
from .rollout import RolloutStep


class LidarTurnInRain(NamedTuple):
    """Virtual lidar of a step: its output, and the sensor's pose (x forward, y left, z up) in the world."""

    step: int
    scan: RainyScan
    sensor_to_world: Float64[np.ndarray, "4 4"]


def rollout_lidar_turns(played: RolloutPlayback, sensor: LidarSensor) -> Iterator[LidarTurnInRain]:
    """Yield the turn of a level lidar on the ego's roof at each step, in the scenario's rain and vehicles' spray.

    Intensities are the reflectances of what is hit (0..1, with the cosine of incidence), corrected for range, and
    weaker in rain: those of a calibrated sensor, as captures have them.
    """
    rainfall = RainSimulation.start(played.scenario.rain)
    for step in played.rollout.steps:
        scene, rig = played.scene(step.time_s), played.rig_to_world(step.time_s)
        time_s, pose = played.scene_time_s(step.time_s), ego_pose(step)
        pose[2, 3] += ROOF_M
        beams, spray = scan_scene(scene, time_s, pose, sensor), spray_of(scene, rainfall, time_s)
        beams = replace(beams, intensities=beams.reflectances.astype(np.float32))
        anchor = leveled_frame(rig[:3, 0], rig[:3, 3])
        yield LidarTurnInRain(step.step, scan_in_rain(beams, sensor, rainfall, anchor, spray=spray), pose)


def ego_pose(step: RolloutStep) -> Float64[np.ndarray, "4 4"]:
    """Pose of the vehicle's frame in the world."""
    return upright_pose(step.ego.x_m, step.ego.y_m, step.ego.z_m, step.ego.yaw_rad)


def upright_pose(x_m: float, y_m: float, z_m: float, yaw_rad: float) -> Float64[np.ndarray, "4 4"]:
    """Pose in the world of a thing that is rotated about the vertical only."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("z", yaw_rad).as_matrix()
    pose[:3, 3] = (x_m, y_m, z_m)
    return pose
