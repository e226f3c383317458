"""Checkpoints of nerfstudio (Tancik et al. 2023): splatfacto, and MTGS (Li et al. 2025) with moving objects.

Sources: https://github.com/nerfstudio-project/nerfstudio and `mtgs/scene_model/` in
https://github.com/OpenDriveLab/MTGS. A checkpoint is {"pipeline": {KEY: tensor}, "step", ...}; keys of Gaussians end in
gauss_params.means and the like. `dataparser_transforms.json` leads back to the capture's own coordinates. MTGS sees a
road in several drives: colors are the mean over them.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from gsrain_engine.safe_io.errors import SceneFormatError, convert_checked
from gsrain_engine.safe_io.limits import read_file
from gsrain_engine.safe_io.text_files import json_values
from gsrain_engine.scene.formats import printable_name
from gsrain_engine.scene.formats.boxed_actor import FORWARD, UP, boxed_actor, poses_of, valid_between
from gsrain_engine.scene.formats.tensors import SplatTensors, activated, array_of
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Actor, Layer, Scene

from .naming import has_tensors, scene_name, settings_text

_KEY = re.compile(r"(?:_model\.)?(?:gaussian_models\.(?P<node>.+?)\.)?(?:gauss_params\.)?(?P<name>\w+)")
_NEEDED = ("means", "scales", "quats", "features_dc", "opacities")
_TRANSFORMS, _CONFIG = "dataparser_transforms.json", "config.yml"
_ANTIALIASED = re.compile(r"rasterize_mode:\s*antialiased")
_RATE = 10.0  # frames per second of nuPlan's cameras, as MTGS reads them
_ABSENT = 1e4  # coordinate from which an object is nowhere: MTGS puts absent ones at a height of 100 km
_MOST = 0.99  # fraction of an object's Gaussians inside of its box, along each axis: the size of the box is not in it
_Row = Annotated[list[float], Meta(min_length=4, max_length=4)]


class _Transforms(msgspec.Struct, frozen=True):
    """`x_trained = scale * transform @ x_captured`."""

    transform: Annotated[list[_Row], Meta(min_length=3, max_length=4)]
    scale: Annotated[float, Meta(gt=0)] = 1.0


def matches(state: Any) -> bool:
    """Return whether a checkpoint has this layout."""
    return has_tensors(state, "pipeline") and any(has_tensors(each, *_NEEDED) for each in _nodes(state).values())


def scene_of(path: Path, state: Any) -> Scene:
    """Scene of a checkpoint; raises `SceneFormatError` if it can't be read."""
    layers: list[Layer] = []
    actors: list[Actor] = []
    folder = path.resolve().parent.parent
    antialiased = _ANTIALIASED.search(settings_text(folder / _CONFIG)) is not None
    for node, tensors in _nodes(state).items():
        if not has_tensors(tensors, *_NEEDED):
            continue
        gaussians = replace(activated(path, _trained(tensors)), antialiased=antialiased)
        name = printable_name(node or scene_name(path))
        if has_tensors(tensors, "instance_quats", "instance_trans"):
            actor = _actor(name, gaussians, tensors)
            actors += [] if actor is None else [actor]
        else:
            layers.append(Layer(name, gaussians, "sky" if node == "skybox" else "background"))
    scene = Scene(printable_name(scene_name(path)), tuple(layers), tuple(actors), up=(0.0, 0.0, 1.0))
    return scene if actors else _in_capture(scene, folder / _TRANSFORMS)


def _nodes(state: Any) -> dict[str, dict[str, Any]]:
    """Tensors by their own names, by the names of nodes; the only node of splatfacto has none."""
    nodes: dict[str, dict[str, Any]] = {}
    pipeline: Mapping[Any, Any] = state["pipeline"] if isinstance(state["pipeline"], Mapping) else {}
    for key, tensor in pipeline.items():
        if found := _KEY.fullmatch(str(key)):
            nodes.setdefault(found["node"] or "", {})[found["name"]] = tensor
    return nodes


def _trained(tensors: Mapping[str, Any]) -> SplatTensors:
    means, scales, quaternions, constant, logits = (tensors[name] for name in _NEEDED)
    others = tensors.get("features_rest")
    if (by_drive := tensors.get("features_adapters")) is not None:
        constant = constant + by_drive.reshape(len(means), -1, 3).mean(dim=1)
    if others is not None and others.ndim == 4:
        others = others.mean(dim=1)
    squashed = others is None or others.numel() == 0
    others = None if squashed else others
    return SplatTensors(
        means, scales, quaternions, logits, constant, others, tensors.get("filter_3D"), is_squashed=squashed
    )


def _actor(name: str, gaussians: Gaussians, tensors: Mapping[str, Any]) -> Actor | None:
    """Actor of a node with poses for each frame, or one pose; None if it is absent in all frames."""
    positions = array_of(tensors["instance_trans"]).astype(np.float64).reshape(-1, 3)
    turns = array_of(tensors["instance_quats"]).astype(np.float64).reshape(-1, 4)
    there = np.abs(positions).max(axis=1) < _ABSENT
    if not len(gaussians) or not there.any():
        return None
    half = np.quantile(np.abs(gaussians.means.astype(np.float64)), _MOST, axis=0)
    times, poses = np.flatnonzero(there) / _RATE, poses_of(positions[there], turns[there])
    class_name = "car" if name.startswith("rigid") else "object"
    return boxed_actor(name, class_name, gaussians, FORWARD, UP, [-half, half], times, poses, valid_between(there))


def _in_capture(scene: Scene, transforms: Path) -> Scene:
    """Scene in the coordinates of the capture that it was trained from, if the file that leads there exists."""
    try:
        found = convert_checked(json_values(read_file(transforms)), _Transforms)
        to_capture = np.linalg.inv(np.array([*found.transform[:3], [0, 0, 0, 1 / found.scale]]) * found.scale)
        to_capture /= to_capture[3, 3]
    except FileNotFoundError:
        return replace(scene, up_is_assumed=True, unit_is_assumed=True)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise SceneFormatError(transforms, f"no transform of a data parser: {error}") from None
    x, y, z = (to_capture[:3, 2] / np.linalg.norm(to_capture[:3, 2])).tolist()
    layers = tuple(replace(each, to_scene=to_capture) for each in scene.layers)
    return replace(scene, layers=layers, up=(x, y, z), unit_is_assumed=True)
