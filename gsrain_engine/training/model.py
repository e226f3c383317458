"""The trained model: static Gaussians, sky and actors, with scene export."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Shaped

from ..datasets.capture import EGO_HEIGHT_M, Capture, CaptureFrame
from ..render.autodiff.differentiable import Rendered, render_gaussians
from ..render.gsplat_input import uploaded
from ..scene.camera import Camera
from ..scene.camera_path import CameraPath
from ..scene.camera_path_edit import WALKING_M_S, with_constant_speed
from ..scene.gaussians import Gaussians
from ..scene.geometry import quaternions_from_matrices
from ..scene.scene import Actor, Layer, RigCamera, Scene, rotation_to_z_up
from ..training_run import arrays_of
from .parameters import SplatParameters, rotate_quaternions

torch: Any = import_module("torch")
Tensor = Any


class TrainingRender(NamedTuple):
    """A render used for training."""

    color: Tensor
    """(h, w, 3), with the sky behind everything."""
    front: Rendered
    """The static scene, then the actors, without the sky."""
    background_rows: slice
    """Rows of the rendered Gaussians that belong to the static scene."""
    actor_rows: dict[str, slice]
    """Rows of each actor that is present at the time."""
    sky: Rendered | None


@dataclass(frozen=True, slots=True, eq=False)
class SplatModel:
    """All trained Gaussians; exposures are separate."""

    background: SplatParameters
    sky: SplatParameters | None
    actors: Mapping[str, SplatParameters]
    """By id, in their own frames. Colors are view-independent, so that frames can rotate without rotating harmonics."""
    tracks: Mapping[str, Actor]
    """The initial actors; their tracks are not trained."""

    def render(self, camera: Camera, time_s: float, sh_degree: int = 3) -> TrainingRender:
        """Render everything from a camera at a time, with harmonics up to a degree."""
        pieces = [_ActivatedPart.of(self.background, sh_degree)]
        rows, count = dict[str, slice](), len(self.background)
        for key, parameters in self.actors.items():
            pose = self.tracks[key].track.pose(time_s)
            if pose is not None and len(parameters):
                pieces.append(_ActivatedPart.of(parameters, sh_degree).moved(pose))
                rows[key] = slice(count, count + len(parameters))
                count += len(parameters)
        if len(pieces) > 1:
            harmonics = max(piece.sh.shape[1] for piece in pieces)
            padded = (piece.padded(harmonics) for piece in pieces)
            pieces = [_ActivatedPart(*(torch.cat(each) for each in zip(*padded, strict=True)))]
        front = render_gaussians(*pieces[0], camera)
        sky = None
        if self.sky is not None:  # only its colors are trained
            part = _ActivatedPart.of(self.sky, sh_degree)
            sky = render_gaussians(*_ActivatedPart(*(each.detach() for each in part))._replace(sh=part.sh), camera)
        color = front.color if sky is None else torch.addcmul(front.color, (1 - front.alpha)[..., None], sky.color)
        return TrainingRender(color, front, slice(0, len(self.background)), rows, sky)

    @property
    def parts(self) -> Iterator[tuple[str, SplatParameters]]:
        yield "background", self.background
        if self.sky is not None:
            yield "sky", self.sky
        for key, parameters in self.actors.items():
            yield f"actors/{key}", parameters

    @property
    def count(self) -> int:
        return sum(len(parameters) for _, parameters in self.parts)

    def zero_grad(self) -> None:
        for _, parameters in self.parts:
            parameters.zero_grad()

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        return {f"{part}:{name}": array for part, each in self.parts for name, array in each.state().items()}

    def restore(self, state: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
        """Restore the output of `state`; raises KeyError if something is missing."""
        for part, parameters in self.parts:
            parameters.restore(arrays_of(state, part))


class _ActivatedPart(NamedTuple):
    """Activated Gaussians for one render."""

    means: Tensor
    scales: Tensor
    quaternions: Tensor
    opacities: Tensor
    sh: Tensor

    @classmethod
    def of(cls, parameters: SplatParameters, sh_degree: int) -> "_ActivatedPart":
        tensors = parameters.tensors
        sh = parameters.sh_up_to(sh_degree)
        return cls(tensors["means"], parameters.scales, tensors["quaternions"], parameters.opacities, sh)

    def padded(self, harmonics: int) -> "_ActivatedPart":
        """Add harmonics of 0 up to a number."""
        missing = harmonics - self.sh.shape[1]
        return self._replace(sh=torch.nn.functional.pad(self.sh, (0, 0, 0, missing))) if missing else self

    def moved(self, pose: Float64[np.ndarray, "4 4"]) -> "_ActivatedPart":
        """Transform from an object's frame to the world; colors are unchanged."""
        matrix = uploaded(pose, self.means.device).to(self.means.dtype)
        quaternions = rotate_quaternions(quaternions_from_matrices(pose[:3, :3]), self.quaternions)
        return self._replace(means=self.means @ matrix[:3, :3].T + matrix[:3, 3], quaternions=quaternions)


# Model to scene

RIG = "capture"
_MIN_VISIBLE_ALPHA = 1 / 255  # smallest alpha that renderers draw


def scene_of(model: SplatModel, capture: Capture, *, keep_lenses: bool = False) -> Scene:
    """Return the current scene in the capture's units and axes; cameras of its rig are pinholes, unless as captured."""
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
        rigs=_rigs(capture, keep_lenses=keep_lenses),
        ego=capture.ego,
        path=recorded_path(capture.views) if capture.ego is None else None,
        unit_is_assumed=not capture.is_metric,
    )


def recorded_path(views: Sequence[CaptureFrame]) -> CameraPath | None:
    """Path through the first camera's recorded poses; at walking pace if the capture has no times."""
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
    return path if is_timed else with_constant_speed(path, WALKING_M_S)


def _visible(gaussians: Gaussians) -> Gaussians:
    """Remove Gaussians that no renderer draws: too faint or not finite."""
    finite = np.isfinite(gaussians.means).all(axis=1) & np.isfinite(gaussians.scales).all(axis=1)
    finite &= np.isfinite(gaussians.quaternions).all(axis=1) & np.isfinite(gaussians.sh).all(axis=(1, 2))
    return gaussians.take(np.flatnonzero(finite & (gaussians.opacities >= _MIN_VISIBLE_ALPHA)))


def _ground_m(capture: Capture) -> float | None:
    """Height of the road in the world, from the vehicle's frame; None without a vehicle."""
    if capture.ego is None or not capture.is_metric or not len(capture.ego.positions):
        return None
    heights = capture.ego.positions @ rotation_to_z_up(capture.up)[2]
    return float(np.median(heights)) - EGO_HEIGHT_M


def _rigs(capture: Capture, *, keep_lenses: bool) -> dict[str, tuple[RigCamera, ...]]:
    """One rig with every sensor of the capture, mounted as in its first view with a known vehicle pose."""
    if capture.ego is None:
        return {}
    mounted = dict[str, RigCamera]()
    for view in capture:
        pose = capture.ego.pose(view.time_s)
        if view.sensor not in mounted and pose is not None:
            camera = view.camera
            mounted[view.sensor] = RigCamera(
                view.sensor or "camera", camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy,
                np.linalg.inv(pose) @ camera.camera_to_world, camera.exposure_s, view.lens if keep_lenses else None,
            )  # fmt: skip
    return {RIG: tuple(mounted.values())} if mounted else {}
