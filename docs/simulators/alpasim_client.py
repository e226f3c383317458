"""Asks `gsrain serve` for the first picture of the first scene's first camera, as AlpaSim does."""

from pathlib import Path

import grpc
from alpasim_grpc.v0 import common_pb2, sensorsim_pb2, sensorsim_pb2_grpc
from scipy.spatial.transform import Rotation


def turn(quat):
    return Rotation.from_quat([quat.x, quat.y, quat.z, quat.w])


def place(vec):
    return [vec.x, vec.y, vec.z]


channel = grpc.insecure_channel("localhost:50051", [("grpc.max_receive_message_length", 2**26)])
stub = sensorsim_pb2_grpc.SensorsimServiceStub(channel)
scene_id = stub.get_available_scenes(common_pb2.Empty()).scene_ids[0]
cameras = stub.get_available_cameras(sensorsim_pb2.AvailableCamerasRequest(scene_id=scene_id)).available_cameras
drives = stub.get_available_trajectories(sensorsim_pb2.AvailableTrajectoriesRequest(scene_id=scene_id))
camera, moment = cameras[0], drives.available_trajectories[0].trajectory.poses[0]
rig, mount = moment.pose, camera.rig_to_camera  # from the camera to the rig, whatever its name says
x, y, z = turn(rig.quat).apply(place(mount.vec)) + place(rig.vec)
qx, qy, qz, qw = (turn(rig.quat) * turn(mount.quat)).as_quat()
pose = common_pb2.Pose(vec=common_pb2.Vec3(x=x, y=y, z=z), quat=common_pb2.Quat(w=qw, x=qx, y=qy, z=qz))
request = sensorsim_pb2.RGBRenderRequest(
    scene_id=scene_id,
    camera_intrinsics=camera.intrinsics,
    frame_start_us=moment.timestamp_us,
    frame_end_us=moment.timestamp_us,
    sensor_pose=sensorsim_pb2.PosePair(start_pose=pose, end_pose=pose),
)
Path("picture.png").write_bytes(stub.render_rgb(request).image_bytes)
