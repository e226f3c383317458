"""Checkpoints of StreetGaussians (Yan et al. 2024): background, objects and a cubemap of the sky.

Source: `lib/models/` in https://github.com/zju3dv/street_gaussians. A checkpoint is {"background", "obj_000", ...,
"actor_pose", "sky_cubemap", "iter"}, where tracks are corrections of those in the data set: objects are hidden actors.
Colors of objects are a Fourier series over time, of which the mean is read.
"""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gsrain_engine.scene.formats import printable_name
from gsrain_engine.scene.formats.boxed_actor import hidden_actor
from gsrain_engine.scene.formats.tensors import SplatTensors, activated, array_of
from gsrain_engine.scene.scene import Actor, Layer, Scene
from gsrain_engine.scene.sky_dome import checked_cubemap, dome_layer, sample_cubemap

from .naming import has_tensors, scene_name

logger = logging.getLogger("gsrain")
_GAUSSIANS = ("xyz", "feature_dc", "feature_rest", "scaling", "rotation", "opacity")
_OBJECT = "obj_"


def matches(state: Any) -> bool:
    """Return whether a checkpoint has this layout."""
    return isinstance(state, Mapping) and any(has_tensors(each, *_GAUSSIANS) for each in state.values())


def scene_of(path: Path, state: Any) -> Scene:
    """Scene of a checkpoint; raises `SceneFormatError` if it can't be read."""
    layers: list[Layer] = []
    actors: list[Actor] = []
    for name, tensors in state.items():
        if not has_tensors(tensors, *_GAUSSIANS):
            continue
        means, dc, rest, scales, quaternions, logits = (tensors[each] for each in _GAUSSIANS)
        mean_color = dc.reshape(len(means), -1, 3)[:, :1]
        gaussians = activated(path, SplatTensors(means, scales, quaternions, logits, mean_color, rest))
        if str(name).startswith(_OBJECT):
            actors.append(hidden_actor(printable_name(name), gaussians))
        else:
            layers.append(Layer(printable_name(name), gaussians, "sky" if name == "sky" else "background"))
    if actors:
        logger.warning("%s: the tracks of %d objects are not in it: they are hidden actors", path, len(actors))
    sky = state.get("sky_cubemap")
    if has_tensors(sky, "params") and has_tensors(sky["params"], "sky_cube_map"):
        cubemap = checked_cubemap(array_of(sky["params"]["sky_cube_map"]))
        layers.append(dome_layer(lambda ways: sample_cubemap(cubemap, ways), layers))
    return Scene(printable_name(scene_name(path)), tuple(layers), tuple(actors), up=(0.0, 0.0, 1.0))
