"""Virtual lidar of a roll-out, in its scene and rain."""

from collections.abc import Iterator

from ..evaluation.lidar.scan import ROOF_M, scan_in_rain, scan_scene
from ..evaluation.lidar.sensor import LidarSensor
from ..rain.simulation import RainSimulation
from ..render.view import leveled_frame
from ..water.spray import spray_of
from .interop.ros2_bag import LidarTurnInRain, ego_pose
from .playback import RolloutPlayback


def rollout_lidar_turns(played: RolloutPlayback, sensor: LidarSensor) -> Iterator[LidarTurnInRain]:
    """Yield the turn of a level lidar on the ego's roof at each step, in the scenario's rain and vehicles' spray."""
    rainfall = RainSimulation.start(played.scenario.rain)
    for step in played.rollout.steps:
        scene, rig = played.scene(step.time_s), played.rig_to_world(step.time_s)
        time_s, pose = played.scene_time_s(step.time_s), ego_pose(step)
        pose[2, 3] += ROOF_M
        beams, spray = scan_scene(scene, time_s, pose, sensor), spray_of(scene, rainfall, time_s)
        anchor = leveled_frame(rig[:3, 0], rig[:3, 3])
        yield LidarTurnInRain(step.step, scan_in_rain(beams, sensor, rainfall, anchor, spray=spray), pose)
