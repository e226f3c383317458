"""A training's Gaussians as a scene: layers, actors, the rig and the ego of the capture."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsrain_engine.datasets.capture import EGO_HEIGHT_M, Capture, View
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.members import Layer
from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.paths.pace import WALKING_M_S, paced
from gsrain_engine.scene.rotations import quaternions_from_matrices
from gsrain_engine.scene.scene import RigCamera, Scene, rotation_to_z_up

from .model import SplatModel

RIG = "capture"
_SEEN = 1 / 255
"""Renderers cut what is fainter."""


def scene_of(model: SplatModel, capture: Capture) -> Scene:
    """Return the scene as it is now, in the capture's units and axes."""
    layers = [Layer("background", _visible(model.background.to_gaussians()))]
    if model.sky is not None:
        layers.append(Layer("sky", model.sky.to_gaussians(), kind="sky"))
    actors = (replace(model.tracks[key], gaussians=each.to_gaussians()) for key, each in model.actors.items())
    return Scene(
        capture.name,
        tuple(layers),
        tuple(actors),
        up=capture.up,
        ground_m=_ground_m(capture),
        rigs=_rigs(capture),
        ego=capture.ego,
        path=recorded_path(capture.views) if capture.ego is None else None,
        unit_is_assumed=not capture.is_metric,
    )


def recorded_path(views: Sequence[View]) -> CameraPath | None:
    """Fly where the first camera was, picture by picture; at walking pace where the capture has no times."""
    own = [view for view in views if view.sensor == views[0].sensor]
    if len(own) < 2:
        return None
    times = np.array([view.time_s for view in own])
    is_timed = bool(np.all(np.diff(times) > 0))
    if not is_timed:
        times = np.arange(len(own), dtype=np.float64)
    poses = np.stack([view.camera.camera_to_world for view in own])
    fields = np.array([view.camera.vertical_fov_deg for view in own])
    path = CameraPath(times, poses[:, :3, 3], quaternions_from_matrices(poses[:, :3, :3]), fields)
    return path if is_timed else paced(path, WALKING_M_S)


def _visible(gaussians: Gaussians) -> Gaussians:
    """Leave out what no renderer draws: too faint, or no numbers."""
    finite = np.isfinite(gaussians.means).all(axis=1) & np.isfinite(gaussians.scales).all(axis=1)
    finite &= np.isfinite(gaussians.quaternions).all(axis=1) & np.isfinite(gaussians.sh).all(axis=(1, 2))
    return gaussians.take(np.flatnonzero(finite & (gaussians.opacities >= _SEEN)))


def _ground_m(capture: Capture) -> float | None:
    """Height of the road in the world, from where the vehicle's frame is; None without a vehicle."""
    if capture.ego is None or not capture.is_metric or not len(capture.ego.positions):
        return None
    heights = capture.ego.positions @ rotation_to_z_up(capture.up)[2]
    return float(np.median(heights)) - EGO_HEIGHT_M


def _rigs(capture: Capture) -> dict[str, tuple[RigCamera, ...]]:
    """One rig with every sensor of the capture, mounted as in its first view that has the vehicle's place."""
    if capture.ego is None:
        return {}
    mounted = dict[str, RigCamera]()
    for view in capture:
        pose = capture.ego.pose(view.time_s)
        if view.sensor not in mounted and pose is not None:
            mounted[view.sensor] = _mounted(view, pose)
    return {RIG: tuple(mounted.values())} if mounted else {}


def _mounted(view: View, ego_to_world: Float64[np.ndarray, "4 4"]) -> RigCamera:
    camera = view.camera
    return RigCamera(
        view.sensor or "camera", camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy,
        np.linalg.inv(ego_to_world) @ camera.camera_to_world, camera.exposure_s,
    )  # fmt: skip
