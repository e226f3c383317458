"""Protocol of `gsrain serve` for CARLA's cameras and lidars, by carla-canvas."""

import os
from typing import Any

import psutil

from gsrain_engine.simulation.serving.grpc_protocol import grpc_protocol
from gsrain_engine.simulation.serving.grpc_server import RenderServer
from gsrain_engine.simulation.serving.scenes import ServedScenes

CANVAS_PROGRAM = "CARLA_CANVAS_PARENT_PID"


def program_is_gone() -> bool:
    """Return whether the program of CARLA that started this server, as its configuration said, has ended."""
    number = os.environ.get(CANVAS_PROGRAM, "")
    return number.isdigit() and not psutil.pid_exists(int(number))


def _classes() -> tuple[type[RenderServer[Any]], type[ServedScenes]]:
    from .service import CanvasServer  # loads messages of gRPC

    return CanvasServer, ServedScenes


PROTOCOL = grpc_protocol(
    "CARLA's cameras and lidars, by carla-canvas", ("grpc", "carla_canvas"), _classes, program_is_gone
)
