"""Our own file of a transfer's weights: safetensors with everything that differs from SD-Turbo, whole or not at all."""

import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from gsrain_engine.scene.atomic_files import whole_file

from .architecture import ARCHITECTURES
from .delta import TurboDelta, check_names, given_out, plain_tensors
from .lora import LowRank
from .model import CycleGanTurbo
from .sorted_header import sort_header

Tensor = Any

FORMAT = "gsrain-cyclegan-turbo"
_VERSION = "1"
_FACTORS = ("lora_A.weight", "lora_B.weight", "alpha")
_PROBE = "unet.conv_out.bias"
"""A tensor of the base that nothing trains, kept to see that weights are put onto what they were made for."""
_PROBE_TOLERANCE = 2e-2
"""Relative to the largest value: halves of float precision are the same base."""


def is_own(metadata: Mapping[str, str]) -> bool:
    """Whether the header of a .safetensors says that it is such a file."""
    return metadata.get("format") == FORMAT


def write_own(model: CycleGanTurbo, path: Path) -> None:
    """Write what a model has beyond SD-Turbo; raises ValueError where that is nothing."""
    delta = given_out(model)
    tensors: dict[str, Tensor] = {f"base.{_PROBE}": plain_tensors(model)[_PROBE]}
    for name, addition in delta.additions.items():
        alpha = addition.down.new_tensor(addition.scale * addition.down.shape[0])
        tensors |= dict(zip((f"{name}.{f}" for f in _FACTORS), (addition.down, addition.up, alpha), strict=True))
    tensors |= delta.replaced
    assert delta.captions is not None and delta.texts is not None
    tensors |= {"captions.a2b": delta.captions[0], "captions.b2a": delta.captions[1]}
    header = {
        "format": FORMAT,
        "version": _VERSION,
        "architecture": model.architecture.name,
        "guide": delta.guide,
        "rank_unet": str(delta.ranks.unet),
        "rank_vae": str(delta.ranks.vae),
        "caption_a2b": delta.texts[0],
        "caption_b2a": delta.texts[1],
    }
    if model.seed is not None:
        header["random_base_seed"] = str(model.seed)
    header["tensors"] = json.dumps(sorted(tensors))
    save: Any = import_module("safetensors.torch").save_file
    plain = {name: each.detach().cpu().contiguous() for name, each in tensors.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside:
        save(plain, beside, metadata=header)
        sort_header(beside)


def read_own(
    tensors: Mapping[str, Tensor], metadata: Mapping[str, str], model: CycleGanTurbo, source: str
) -> TurboDelta:
    """Weights of such a file; raises ValueError for another version, architecture or base, and for unknown keys."""
    check_header(metadata, source)
    if metadata["architecture"] != model.architecture.name:
        raise ValueError(f"{source}: made for {metadata['architecture']}, not for {model.architecture.name}")
    _check_base(tensors, model, source)
    ends = tuple(f".{factor}" for factor in _FACTORS)
    layers = {name.removesuffix(end) for name in tensors for end in ends if name.endswith(end)}
    others = {"captions.a2b", "captions.b2a", f"base.{_PROBE}"}
    known = others | set(json.loads(metadata["tensors"]))
    check_names(tensors, known | {f"{layer}.{factor}" for layer in layers for factor in _FACTORS}, source)
    whole = {name for name in tensors if name not in others and not name.endswith(ends)}
    additions: dict[str, LowRank] = {}
    for layer in layers:
        down, up, alpha = (tensors[f"{layer}.{factor}"] for factor in _FACTORS)
        additions[layer] = LowRank(down, up, float(alpha) / down.shape[0])
    guide = metadata["guide"]
    return TurboDelta(
        source,
        additions,
        {name: tensors[name] for name in whole},
        "normals" if guide == "normals" else "mask" if guide == "mask" else "",
        (tensors["captions.a2b"], tensors["captions.b2a"]),
        (metadata["caption_a2b"], metadata["caption_b2a"]),
    )


def check_header(metadata: Mapping[str, str], source: str) -> None:
    """Raise ValueError where the header of our file lacks a field, or is of another version or architecture."""
    for field in ("version", "architecture", "guide", "caption_a2b", "caption_b2a", "tensors"):
        if field not in metadata:
            raise ValueError(f"{source}: {field!r} is missing from its header")
    if metadata["version"] != _VERSION:
        raise ValueError(f"{source}: version {metadata['version']}, this program reads {_VERSION}")
    if metadata["architecture"] not in ARCHITECTURES:
        raise ValueError(f"{source}: unknown architecture {metadata['architecture']!r}")
    if not metadata.get("random_base_seed", "0").isdecimal():
        raise ValueError(f"{source}: random_base_seed in its header is no number")


def _check_base(tensors: Mapping[str, Tensor], model: CycleGanTurbo, source: str) -> None:
    probe = tensors.get(f"base.{_PROBE}")
    mine = plain_tensors(model)[_PROBE].float().cpu()
    if probe is None or probe.shape != mine.shape:
        raise ValueError(f"{source}: 'base.{_PROBE}' is missing or of another shape")
    if float((probe.float() - mine).abs().max()) > _PROBE_TOLERANCE * float(mine.abs().max()):
        raise ValueError(f"{source}: made upon another base than this one; SD-Turbo of Stability AI is wanted")
