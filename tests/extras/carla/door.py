"""The door of the server for CARLA."""

from random import Random
from typing import Any

from gsrain_engine.simulation.serving.scenes import ServedScenes
from gsrain_extras.carla.service import SERVICE, CanvasServer
from tests.fuzz.doors import COMPILING_S, REFUSALS, Door, GrpcAttack, open_grpc

_NUMBERS = ("", "0", "-0", "1", "-1", "nan", "inf", "-inf", "1e308", "-1e308", "1e-308", "360", "1e9", "x", "9" * 400)


class CarlaAttack(GrpcAttack):
    hanging_method = f"{SERVICE}/Render"

    def __init__(self, address: str) -> None:
        from carla_canvas.v1 import renderer_pb2

        self._pb, self._frames = renderer_pb2, 0
        super().__init__(address)
        self._load(self._sound)

    def _load(self, channel: Any) -> None:
        for name, sent in (
            ("LoadWorld", self._world()),
            ("SpawnSensor", self._sensor(1)),
            ("SpawnSensor", self._sensor(2)),
        ):
            status, _ = self.call(channel, f"{SERVICE}/{name}", sent.SerializeToString())
            assert status in ("OK", "RESOURCE_EXHAUSTED"), status

    def connected(self) -> Any:
        channel = super().connected()
        self._load(channel)
        return channel

    def _world(self) -> Any:
        sent = self._pb.LoadWorldRequest(map_name="Carla/Maps/dry", episode_id=7)
        sent.renderer_config.update({"options": {"a": 1.0}, "assets": {"maps": {"*": {"scene": "dry"}}}})
        return sent

    def _sensor(self, number: int) -> Any:
        kind = "sensor.camera.rgb" if number == 1 else "sensor.lidar.ray_cast"
        actor = self._pb.Actor(id=number, type_id=kind)
        given = {"image_size_x": 24, "image_size_y": 16, "fov": 60} if number == 1 else {
            "channels": 4, "range": 60, "points_per_second": 2000, "upper_fov": 5, "lower_fov": -8,
            "rotation_frequency": 10, "horizontal_fov": 360, "noise_stddev": 0, "noise_seed": 1,
            "dropoff_general_rate": 0, "dropoff_intensity_limit": 0, "dropoff_zero_intensity": 0.4,
            "atmosphere_attenuation_rate": 0.004,
        }  # fmt: skip
        for name, value in given.items():
            actor.attributes.add(id=name, value=str(value))
        return self._pb.SpawnSensorRequest(sensor=actor)

    def _frame(self, frame: int) -> Any:
        sent = self._pb.RenderRequest()
        stamp = sent.snapshot.timestamp
        stamp.frame, stamp.elapsed_seconds, stamp.delta_seconds = frame, 1.0, 0.05
        for number in (1, 2):
            row = sent.snapshot.actors.add(id=number)
            row.transform.location.x, row.transform.location.z = 2.0, 1.5
            sent.sensors.add(sensor_id=number, deliver=True)
        return sent

    def hostile(self, chance: Random) -> tuple[str, Any]:
        self._frames += 1
        name = chance.choice(
            ("LoadWorld", "SpawnSensor", "SpawnSensor", "Render", "Render", "GetInfo", "DestroySensor")
        )
        sent = {
            "LoadWorld": self._world, "SpawnSensor": lambda: self._sensor(chance.choice((1, 2))),
            "Render": lambda: self._frame(self._frames), "GetInfo": self._pb.GetInfoRequest,
            "DestroySensor": lambda: self._pb.DestroySensorRequest(sensor_id=1),
        }[name]()  # fmt: skip
        if name == "Render":
            fresh = self._sensor(2)
            chance.choice(fresh.sensor.attributes).value = chance.choice(_NUMBERS)
            status, _ = self.call(self._channel, f"{SERVICE}/SpawnSensor", fresh.SerializeToString())
            assert status in REFUSALS | {"OK"}, status
        return f"{SERVICE}/{name}", sent

    def sound(self, channel: Any) -> bytes:
        self._frames += 1
        sent = self._frame(self._frames)
        del sent.sensors[1:]
        _, data = self.call(channel, f"{SERVICE}/Render", sent.SerializeToString(), patience_s=COMPILING_S)
        return self._pb.RenderResponse.FromString(data).measurements[0].image.raw_data if data else b""


DOOR = Door("carla", "carla_canvas", lambda: open_grpc(CanvasServer, ServedScenes), CarlaAttack, 800 << 20)
