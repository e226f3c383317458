"""Checkpoints of one set of Gaussians: of gsplat's trainer (Ye et al. 2024), and of 3DGS (Kerbl et al. 2023) and kin.

Sources: `examples/simple_trainer.py` in https://github.com/nerfstudio-project/gsplat, {"step", "splats": {means,
scales, quats, opacities, sh0, shN}}, one file for each GPU; `GaussianModel.capture` in
https://github.com/graphdeco-inria/gaussian-splatting, ((SH degree, means, SH of degree 0, other SH, log scales,
quaternions, logits, ...), iteration). gsplat turns captures so that z is up.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats import printable_name
from gsrain_engine.scene.formats.tensors import SplatTensors, activated, load_tensors
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Layer, Scene
from gsrain_engine.scene.transforms import FILE_UP

from .naming import has_tensors, scene_name, settings_text

_SPLATS = ("means", "scales", "quats", "opacities")
_CAPTURED = range(11, 14)
"""Numbers of values that `capture` returns: 12 of 3DGS, 11 or 13 of programs that derive from it."""

_RANKED = re.compile(r"(.*_rank)0(\.\w+)")
_ANTIALIASED = re.compile(r"^antialiased:\s*true", re.MULTILINE)


def matches(state: Any) -> bool:
    """Return whether a checkpoint has one of these layouts."""
    return _is_captured(state) or (has_tensors(state, "splats") and has_tensors(state["splats"], *_SPLATS))


def scene_of(path: Path, state: Any) -> Scene:
    """Scene of a checkpoint; raises `SceneFormatError` if it can't be read."""
    name = printable_name(scene_name(path))
    if _is_captured(state):
        degree, means, dc, rest, scales, quaternions, logits = state[0][:7]
        trained = SplatTensors(means, scales, quaternions, logits, dc, rest)
        gaussians, up = activated(path, trained, max_degree=int(degree)), FILE_UP
    else:
        antialiased = _ANTIALIASED.search(settings_text(path.resolve().parent.parent / "cfg.yml")) is not None
        parts = [_splats(path, state["splats"]), *(_splats(each, _other(each)) for each in _other_ranks(path))]
        gaussians, up = replace(Gaussians.concatenate(parts), antialiased=antialiased), (0.0, 0.0, 1.0)
    return Scene(name, (Layer(name, gaussians),), up=up, up_is_assumed=True, unit_is_assumed=True)


def _is_captured(state: Any) -> bool:
    is_pair = isinstance(state, tuple | list) and len(state) == 2 and isinstance(state[0], tuple | list)
    return is_pair and len(state[0]) in _CAPTURED and isinstance(state[0][0], int)


def _splats(path: Path, splats: Mapping[str, Any]) -> Gaussians:
    if "sh0" not in splats:
        raise SceneFormatError(path, "its colors are features of a network (app_opt), which is not read")
    means, scales, quaternions, logits = (splats[name] for name in _SPLATS)
    others = splats.get("shN")
    return activated(
        path, SplatTensors(means, scales, quaternions, logits, splats["sh0"], others, splats.get("filter_3D"))
    )


def _other_ranks(path: Path) -> list[Path]:
    """Files of the other GPUs of a training."""
    found = _RANKED.fullmatch(path.name)
    if found is None:
        return []
    ranks = (path.with_name(f"{found[1]}{rank}{found[2]}") for rank in range(1, 1024))
    return [each for each in ranks if each.is_file()]


def _other(path: Path) -> Mapping[str, Any]:
    state = load_tensors(path)
    if not has_tensors(state, "splats") or not has_tensors(state["splats"], *_SPLATS):
        raise SceneFormatError(path, "no part of the checkpoint of gsplat that it is named after")
    return state["splats"]
