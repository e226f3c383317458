"""Checkpoints of drivestudio (Chen et al. 2025, OmniRe): background, vehicles and people with tracks, sky.

Source: `models/` in https://github.com/ziyc/drivestudio. A checkpoint is {"models": {CLASS: tensors}, "step"}. Boxes of
rigid and deformable nodes have their center at the origin, x forward, z up. Not applied: the networks that deform
people (their canonical pose is placed), that adapt colors to each picture (Affine), and that refine poses of cameras.
"""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from jaxtyping import Float64
from msgspec import Meta

from gsrain_engine.safe_io.errors import SceneFormatError, convert_checked
from gsrain_engine.safe_io.text_files import printable_line, yaml_values
from gsrain_engine.scene.formats import printable_name
from gsrain_engine.scene.formats.boxed_actor import FORWARD, UP, boxed_actor, poses_of, valid_between
from gsrain_engine.scene.formats.tensors import SplatTensors, activated, activated_rows, array_of
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.geometry import matrices_from_quaternions
from gsrain_engine.scene.scene import Actor, Layer, Scene
from gsrain_engine.scene.sky_dome import checked_cubemap, dome_layer, sample_cubemap
from gsrain_engine.scene.transforms import FILE_UP

from .naming import has_tensors, scene_name, settings_text

logger = logging.getLogger("gsrain")
_GAUSSIANS = ("_means", "_scales", "_quats", "_features_dc", "_opacities")
_BACKGROUND, _SKY, _PEOPLE = "Background", "Sky", "SMPLNodes"
_CLASSES = {"RigidNodes": "car", "DeformableNodes": "pedestrian", _PEOPLE: "pedestrian"}
_NETWORKS = {"Affine": "colors of each camera", "CamPose": "refined poses of cameras", "CamPosePerturb": "poses"}
_CONFIG, _RATE = "config.yaml", 10.0  # frames per second of the data sets; that of its videos is set in the file
_UP, _UPS = (0.0, 0.0, 1.0), {"nuscenes": FILE_UP}
_TO_CUBEMAP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
_PELVIS = np.array([-0.0018, -0.2233, 0.0282])
"""Joint about which a person turns, in the axes of SMPL (x left, y up, z forward; Loper et al. 2015, neutral shape)."""


def matches(state: Any) -> bool:
    """Return whether a checkpoint has this layout."""
    return has_tensors(state, "models") and any(has_tensors(each, *_GAUSSIANS) for each in _models(state).values())


def scene_of(path: Path, state: Any) -> Scene:
    """Scene of a checkpoint; raises `SceneFormatError` if it can't be read."""
    models = _models(state)
    layers: list[Layer] = []
    actors: list[Actor] = []
    settings = _settings(path.parent / _CONFIG)
    rate = settings.render.fps
    for name, tensors in models.items():
        if not has_tensors(tensors, *_GAUSSIANS):
            continue
        if has_tensors(tensors, "_velocity"):
            raise SceneFormatError(path, f"the Gaussians of {printable_name(name)} change over time (PVG): not read")
        if has_tensors(tensors, "points_ids"):
            actors += _actors(path, name, tensors, rate)
        else:
            layers.append(Layer(printable_name(name).lower(), activated(path, _trained(tensors))))
        if any(str(key).startswith("deform_network") for key in tensors):
            logger.warning("%s: %s is deformed by a network, which is not applied", path, printable_name(name))
    if people := sum(actor.id.startswith(_PEOPLE) for actor in actors):
        logger.warning("%s: people keep one pose (%d): the model that moves bodies is not in it", path, people)
    if ignored := [words for name, words in _NETWORKS.items() if name in models]:
        logger.info("%s: not applied, as networks: %s", path, ", ".join(ignored))
    up = _up(actors, settings)
    sky = models.get(_SKY)
    if has_tensors(sky, "base"):
        cubemap = checked_cubemap(array_of(sky["base"]))
        layers.append(dome_layer(lambda ways: sample_cubemap(cubemap, ways @ _TO_CUBEMAP.T), layers))
    elif sky is not None:
        logger.warning("%s: its sky is a network, which is not read: the scene has none", path)
    return Scene(
        printable_name(scene_name(path)),
        tuple(layers),
        tuple(actors),
        up=up or (0.0, 0.0, 1.0),
        up_is_assumed=up is None,
    )


def _models(state: Any) -> Mapping[str, Any]:
    models = state["models"]
    return models if isinstance(models, Mapping) else {}


def _trained(tensors: Mapping[str, Any]) -> SplatTensors:
    others = tensors.get("_features_rest")
    has_others = others is not None and others.numel() > 0
    names = ("_means", "_scales", "_quats", "_opacities", "_features_dc")
    means, scales, quaternions, logits, constant = (tensors[name] for name in names)
    return SplatTensors(
        means, scales, quaternions, logits, constant, others if has_others else None, is_squashed=not has_others
    )


def _actors(path: Path, name: str, tensors: Mapping[str, Any], rate: float) -> list[Actor]:
    """Road users of a class, one for each instance that has Gaussians and is present in a frame."""
    present = np.asarray(tensors["instances_fv"].numpy(), np.bool_)
    frames, instances = present.shape
    positions = array_of(tensors["instances_trans"]).astype(np.float64).reshape(frames, instances, 3)
    turns = array_of(tensors["instances_quats"]).astype(np.float64).reshape(frames, instances, 4)
    sizes = array_of(tensors["instances_size"]).astype(np.float64).reshape(instances, 3)
    ids = np.asarray(tensors["points_ids"].numpy(), np.int64).reshape(-1)
    gaussians, fit = activated_rows(path, _trained(tensors))
    ids = ids[fit]
    if len(ids) and not 0 <= ids.min() <= ids.max() < instances:
        raise SceneFormatError(path, f"points_ids of {printable_name(name)} are not those of {instances} instances")
    found: list[Actor] = []
    for k in range(instances):
        rows, there = np.flatnonzero(ids == k), present[:, k]
        if not len(rows) or not there.any():
            continue
        own = gaussians.take(rows)
        poses = poses_of(positions[there, k], turns[there, k])
        if not np.isfinite(poses).all():
            raise SceneFormatError(path, f"{printable_name(name)} {k}: its poses must consist of finite numbers")
        times = np.flatnonzero(there) / rate
        front, up, corners = (
            _of_person(own, poses) if name == _PEOPLE else (FORWARD, UP, np.stack([-sizes[k] / 2, sizes[k] / 2]))
        )
        label = f"{printable_name(name)}_{k}"
        class_name = _CLASSES.get(name, "object")
        found.append(boxed_actor(label, class_name, own, front, up, corners, times, poses, valid_between(there)))
    return found


def _of_person(
    gaussians: Gaussians, poses: Float64[np.ndarray, "t 4 4"]
) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"], Float64[np.ndarray, "2 3"]]:
    """Front, up and box of a person in the axes of SMPL, whose poses are changed to turn about the pelvis."""
    poses[:, :3, 3] += _PELVIS - poses[:, :3, :3] @ _PELVIS
    means = gaussians.means.astype(np.float64)
    return np.array([0.0, 0, 1]), np.array([0.0, 1, 0]), np.stack([means.min(axis=0), means.max(axis=0)])


class _Videos(msgspec.Struct, frozen=True):
    fps: Annotated[float, Meta(gt=0, le=1000)] = _RATE


class _Data(msgspec.Struct, frozen=True):
    dataset: str = ""


class _Settings(msgspec.Struct, frozen=True):
    """Settings of a training that matter here."""

    render: _Videos = _Videos()
    data: _Data = _Data()


def _settings(path: Path) -> _Settings:
    try:
        return convert_checked(yaml_values(settings_text(path).encode()) or {}, _Settings)
    except ValueError as error:
        logger.warning("%s: not used: %s", path, printable_line(error))
        return _Settings()


def _up(actors: list[Actor], settings: _Settings) -> tuple[float, float, float] | None:
    """Axis of the scene nearest to the upward directions of vehicles, else that of the data set; None if unknown."""
    turns = [actor.track.quaternions_wxyz for actor in actors if actor.class_name == "car"]
    if turns:
        mean = matrices_from_quaternions(np.concatenate(turns))[:, :, 2].mean(axis=0)
        largest = int(np.abs(mean).argmax())
        x, y, z = (float(np.sign(mean[largest])) * (axis == largest) for axis in range(3))
        return x, y, z
    return _UPS.get(settings.data.dataset, _UP) if settings.data.dataset else None
