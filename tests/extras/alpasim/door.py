"""The door of AlpaSim's server."""

from random import Random
from typing import Any

from gsrain_extras.alpasim.messages import SERVICE, calls, message
from gsrain_extras.alpasim.service import SensorsimServer
from gsrain_extras.alpasim.simulator import Simulator
from tests.fuzz.doors import COMPILING_S, Door, GrpcAttack, open_grpc


class AlpaSimAttack(GrpcAttack):
    hanging_method = f"{SERVICE}/render_rgb"

    def __init__(self, address: str) -> None:
        super().__init__(address)
        camera = message("AvailableCamerasRequest")(scene_id="dry")
        status, answer = self.call(self._sound, f"{SERVICE}/get_available_cameras", camera.SerializeToString())
        assert status == "OK"
        (camera,) = message("AvailableCamerasReturn").FromString(answer).available_cameras
        picture = message("RGBRenderRequest")(
            scene_id="dry", resolution_w=24, resolution_h=16, frame_start_us=1_000_000, frame_end_us=1_040_000,
            image_format=1,
        )  # fmt: skip
        picture.camera_intrinsics.CopyFrom(camera.intrinsics)
        for pose in (picture.sensor_pose.start_pose, picture.sensor_pose.end_pose):
            pose.vec.x, pose.vec.z = 2, 1.5
            pose.quat.w, pose.quat.x, pose.quat.y, pose.quat.z = 0.5, -0.5, 0.5, -0.5
        self._picture = picture

    def hostile(self, chance: Random) -> tuple[str, Any]:
        name = chance.choice((*calls(SERVICE), "render_rgb", "render_rgb", "render_rgb", "none"))
        if name not in calls(SERVICE):
            return f"{SERVICE}/{name}", message("RGBRenderRequest")()
        request = calls(SERVICE)[name].request()
        picture = message("RGBRenderRequest")()
        picture.CopyFrom(self._picture)
        picture.scene_id = chance.choice(("dry", "rainy"))
        if name == "render_rgb":
            request.CopyFrom(picture)
        elif name == "render_lidar":
            request.scene_id, request.lidar_config.lidar_type = "dry", 1
            request.sensor_pose.CopyFrom(picture.sensor_pose)
        elif name == "render_aggregated":
            request.rgb_requests.append(picture)
        elif name == "batch_render_rgb":
            request.items.add(camera_name="a", request=picture)
        return f"{SERVICE}/{name}", request

    def sound(self, channel: Any) -> bytes:
        data = self._picture.SerializeToString()
        return self.call(channel, f"{SERVICE}/render_rgb", data, patience_s=COMPILING_S)[1]


DOOR = Door("alpasim", "grpc", lambda: open_grpc(SensorsimServer, Simulator), AlpaSimAttack, 400 << 20)
