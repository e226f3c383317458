"""AlpaSim's protocol of `gsrain serve`."""

from typing import Any

from gsrain_engine.simulation.serving.grpc_protocol import grpc_protocol
from gsrain_engine.simulation.serving.grpc_server import RenderServer
from gsrain_engine.simulation.serving.scenes import ServedScenes


def _classes() -> tuple[type[RenderServer[Any]], type[ServedScenes]]:
    from .service import SensorsimServer  # loads messages of gRPC
    from .simulator import Simulator

    return SensorsimServer, Simulator


PROTOCOL = grpc_protocol("the sensor simulator of NVIDIA's AlpaSim (SensorsimService)", ("grpc",), _classes)
