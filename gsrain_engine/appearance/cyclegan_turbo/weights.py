"""CycleGAN-Turbo's weight files: our format, img2img-turbo and WeatherEdit checkpoints, and diffusers LoRAs."""

import json
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

import msgspec

from ...optional_packages import import_package
from ...safe_io.files import whole_file
from ...safe_io.limits import check_file, check_zip_expansion, open_file
from ...safe_io.text_files import printable_line
from ..base import TrainingRecord
from . import lora
from .lora import LowRank, adapted_layers, addition_of
from .model import ARCHITECTURES, CAPTIONS, CycleGanTurbo, Guide, widen_kernel
from .weight_paths import RANDOM_BASE, TRAINING, record_in

torch: Any = import_module("torch")
Tensor = Any

# Adapter weights: LoRAs, replaced tensors and captions relative to SD-Turbo


@dataclass(frozen=True, slots=True, eq=False)
class AdapterWeights:
    """Weights of one transfer relative to SD-Turbo. Names are those of the whole model without peft."""

    source: str
    """Source file, for messages."""
    additions: Mapping[str, LowRank]
    """LoRAs by layer name, such as "unet.mid_block.resnets.0.conv1"."""
    replaced: Mapping[str, Tensor]
    """Tensors by name, such as "vae.decoder.skip_conv_1.weight"; `additions` are added to them."""
    guide: Guide = ""
    captions: tuple[Tensor, Tensor] | None = None
    """Embeddings for a2b and b2a; None keeps the model's own."""
    texts: tuple[str, str] | None = None

    @property
    def takes_guides(self) -> bool:
        """True if trained with a fourth channel."""
        first = self.replaced.get(f"{_ENCODER_INPUTS[0]}.weight")
        addition = self.additions.get(_ENCODER_INPUTS[0])
        return any(each is not None and each.shape[1] > 3 for each in (first, addition and addition.down))


@dataclass(frozen=True, slots=True, eq=False)
class WeightsFile:
    """Content of a weights file, before the model is known."""

    path: Path
    state: Mapping[str, Any]
    metadata: Mapping[str, str]
    """Header of a .safetensors file."""

    @property
    def architecture(self) -> str:
        return self.metadata.get("architecture", "sd-turbo")

    @property
    def random_base_seed(self) -> int | None:
        """Seed of the random base weights, in tests; None for SD-Turbo."""
        seed = self.metadata.get(RANDOM_BASE)
        return None if seed is None else int(seed)

    @property
    def record(self) -> TrainingRecord | None:
        """Record of the training; None if it is unknown. Raises ValueError for a damaged record."""
        if self.is_own:
            return record_in(self.metadata, self.path)
        return PUBLISHED if "sd_encoder" in self.state else None

    @property
    def takes_guides(self) -> bool:
        """True if trained with a fourth channel."""
        state: Any = self.state.get("sd_vae_dec", self.state)
        ends = ("vae.encoder.conv_in.weight", "vae.encoder.conv_in.base_layer.weight")
        kernels = [state[name] for name in ends if isinstance(state, Mapping) and name in state]
        return any(len(shape) > 1 and shape[1] > 3 for shape in (getattr(each, "shape", ()) for each in kernels))

    @property
    def is_own(self) -> bool:
        """True for a file of our format."""
        return self.metadata.get("format") == FORMAT

    @property
    def texts(self) -> tuple[str, str] | None:
        """Captions for a2b and b2a that the text encoder has to encode; None if the file has their embeddings."""
        return None if self.is_own else published_texts(self.state)

    def delta(self, model: CycleGanTurbo, *, override: bool = False) -> AdapterWeights:
        """Weights relative to SD-Turbo; raises ValueError with the first bad key if they don't fit this model.

        `override` accepts another base than that of the training.
        """
        source = str(self.path)
        try:
            if self.is_own:
                return read_own(self.state, self.metadata, model, source, override=override)
            if "sd_vae_enc" in self.state or "rank_unet" in self.state:
                return read_published(self.state, model, source)
            if any(name.startswith((_PREFIX, _FLAT_PREFIX)) and _ENDING.search(name) for name in self.state):
                return read_diffusers_lora(self.state, self.metadata, model, source)
            some = ", ".join(repr(name) for name in sorted(self.state)[:3])
            raise ValueError(
                f"{source}: neither img2img-turbo's, WeatherEdit's, a LoRA nor our own weights: has {some}"
            )
        except ValueError as error:
            raise ValueError(printable_line(error)) from None
        except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError) as error:
            # Damaged files may hold a value in place of a tensor, or a tensor in place of a number.
            words = printable_line(str(error).split("\n")[0])
            raise ValueError(f"{self.path}: its weights are damaged: {words or type(error).__name__}") from None


def open_weights(path: Path) -> WeightsFile:
    """Read a .pkl (weights only, so none of its code runs) or a .safetensors file.

    Raises FileNotFoundError, and ValueError with the file's name if it can't be read.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file of weights")
    if path.suffix == ".safetensors":
        file = WeightsFile(path, *_read_safetensors(path))
        if file.is_own:
            _check_header(file.metadata, str(path))
        return file
    try:
        with open_file(path) as stream:
            check_zip_expansion(stream, path)
            state = torch.load(stream, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many types
        first = str(error).split("\n")[0].strip() or type(error).__name__
        raise ValueError(f"{path}: not a readable file of torch weights: {printable_line(first)}") from None
    if not isinstance(state, Mapping):
        raise ValueError(f"{path}: holds {type(state).__name__}, not weights by name")
    return WeightsFile(path, dict(state.items()), {})


def _read_safetensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    safetensors: Any = import_package("safetensors", f"reading {path}")
    try:
        check_file(path)
        with safetensors.safe_open(path, framework="pt") as file:
            names: list[str] = file.keys()
            return {name: file.get_tensor(name) for name in names}, dict(file.metadata() or {})
    except (safetensors.SafetensorError, AttributeError, OSError, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not a readable .safetensors: {printable_line(error)}") from None


_ENCODER_INPUTS = ("vae.encoder.conv_in", "vae_b2a.encoder.conv_in")


def plain_tensors(model: CycleGanTurbo) -> dict[str, Tensor]:
    """Weights of a model without LoRAs, by their names without peft."""
    return {name.replace(".base_layer.", "."): each for name, each in model.named_parameters() if ".lora_" not in name}


def plain_layers(model: CycleGanTurbo) -> list[str]:
    return [name.removesuffix(".weight") for name, each in plain_tensors(model).items() if each.ndim > 1]


def apply_adapter_weights(model: CycleGanTurbo, delta: AdapterWeights) -> None:
    """Load weights into a model: into its peft adapters if it has them, else merged into its layers.

    Raises ValueError with the first layer or tensor that doesn't fit; the model is then unchanged.
    """
    if model.delta is not None:
        raise ValueError(f"{delta.source}: the model has weights from {model.delta.source} already")
    tensors = plain_tensors(model)
    delta = _fitted(delta, tensors)
    if delta.captions is not None:
        model.check_captions(*delta.captions)
    with torch.no_grad():
        if model.adapted:
            _into_adapters(model, delta)
        for name, value in delta.replaced.items():
            tensors[name].copy_(value)
        for layer, addition in delta.additions.items() if not model.adapted else ():
            weight = tensors[f"{layer}.weight"]
            weight.copy_(addition.added_to(weight))
    if delta.captions is not None:
        model.set_captions(*delta.captions)
    model.texts = delta.texts or model.texts
    model.guide = delta.guide
    model.delta = None if model.adapted else delta


def extract_adapter_weights(model: CycleGanTurbo) -> AdapterWeights:
    """Extract all weights that a model adds to SD-Turbo, including trainable ones that haven't changed.

    Raises ValueError for a model without adapters and loaded weights.
    """
    captions = (model.captions["a2b"], model.captions["b2a"])
    if not model.adapted:
        if model.delta is None:
            raise ValueError("this model is plain SD-Turbo: there is nothing to save")
        return replace(model.delta, captions=captions, texts=model.texts)
    additions = {name: addition_of(layer) for name, layer in adapted_layers(model)}
    whole = {
        name: each
        for name, each in plain_tensors(model).items()
        if each.requires_grad or name.startswith(("unet.conv_in.", *_ENCODER_INPUTS)) or ".skip_conv_" in name
    }
    guide: Guide = ("normals" if model.guide == "" else model.guide) if model.takes_guides else ""
    return AdapterWeights("the model", additions, whole, guide, captions, model.texts)


def check_names(found: Iterable[str], expected: Iterable[str], where: str) -> None:
    """Raise ValueError with the first of each if keys are missing or unknown."""
    have, need = set(found), set(expected)
    faults = [
        f"{first_of(names)} {fault}" for names, fault in ((need - have, "missing"), (have - need, "unknown")) if names
    ]
    if faults:
        raise ValueError(f"{where}: {', and '.join(faults)}")


def first_of(names: Collection[str]) -> str:
    """Beginning of a sentence on names: the first, and the number of others."""
    others = f" and {len(names) - 1} more are" if len(names) > 1 else " is"
    return f"{min(names)!r}{others}"


def _fitted(delta: AdapterWeights, tensors: Mapping[str, Tensor]) -> AdapterWeights:
    """Return weights with kernels widened to the model's channels, without tensors equal to the model's."""
    takes = tensors[f"{_ENCODER_INPUTS[0]}.weight"].shape[1]
    if delta.takes_guides and takes == 3:
        raise ValueError(f"{delta.source}: made with a fourth channel, which this model lacks: open it with normals")
    for name in delta.additions:
        if f"{name}.weight" not in tensors:
            raise ValueError(f"{delta.source}: {name!r} is no layer of this model")
    additions, replaced = dict(delta.additions), dict(delta.replaced)
    for layer in _ENCODER_INPUTS:
        if layer in additions:
            additions[layer] = replace(additions[layer], down=widen_kernel(additions[layer].down, takes))
        if (kernel := f"{layer}.weight") in replaced:
            replaced[kernel] = widen_kernel(replaced[kernel], takes)
    for name, addition in additions.items():
        try:
            addition.check(tuple(tensors[f"{name}.weight"].shape))
        except ValueError as error:
            raise ValueError(f"{delta.source}: {name!r}: {error}") from error
    for name, value in replaced.items():
        if name not in tensors:
            raise ValueError(f"{delta.source}: {name!r} is no tensor of this model")
        if value.shape != tensors[name].shape:
            shapes = f"{tuple(value.shape)}, but the model has {tuple(tensors[name].shape)}"
            raise ValueError(f"{delta.source}: {name!r} is {shapes}")
    for name, value in list(replaced.items()):
        if value.dtype == tensors[name].dtype and torch.equal(value, tensors[name].to(value.device)):
            del replaced[name]
    return replace(delta, additions=additions, replaced=replaced)


def _into_adapters(model: CycleGanTurbo, delta: AdapterWeights) -> None:
    own = {name: addition_of(layer) for name, layer in adapted_layers(model)}
    check_names(delta.additions, own, f"{delta.source}, to be trained on")
    for name, mine in own.items():
        given = delta.additions[name]
        for kind, to, value in (("lora_A", mine.down, given.down), ("lora_B", mine.up, given.up)):
            if to.shape != value.shape:
                shapes = f"{tuple(value.shape)}, but the model has {tuple(to.shape)}"
                raise ValueError(f"{delta.source}: {kind} of {name!r} is {shapes}")
        if abs(mine.scale - given.scale) > 1e-6 * abs(mine.scale):
            raise ValueError(f"{delta.source}: {name!r} counts {given.scale:g} times, {mine.scale:g} in the model")
    for name, mine in own.items():
        mine.down.copy_(delta.additions[name].down)
        mine.up.copy_(delta.additions[name].up)


# Our file format: safetensors with all differences from SD-Turbo, written atomically

FORMAT = "gsrain-cyclegan-turbo"
_VERSION = "1"
_FACTORS = ("lora_A.weight", "lora_B.weight", "alpha")
_PROBE = "unet.conv_out.bias"
"""Untrained tensor of the base, stored to check that weights are applied to the right base."""
_PROBE_TOLERANCE = 2e-2  # tolerance relative to the largest value, so that half-precision copies of the base pass


def save_weights(model: CycleGanTurbo, path: Path, record: TrainingRecord | None = None) -> None:
    """Write all weights that a model adds to SD-Turbo to a .safetensors file: LoRAs, first convolutions, captions.

    `record` is how they were trained; None keeps that of the model.

    Raises ValueError for another suffix, and for plain SD-Turbo.
    """
    if path.suffix != ".safetensors":
        raise ValueError(f"{path}: weights are written as .safetensors")
    delta = extract_adapter_weights(model)
    tensors: dict[str, Tensor] = {f"base.{_PROBE}": plain_tensors(model)[_PROBE]}
    ranks = {"unet": 0, "vae": 0}
    for name, addition in delta.additions.items():
        rank, part = addition.down.shape[0], "unet" if name.startswith("unet.") else "vae"
        ranks[part] = max(ranks[part], rank)
        alpha = addition.down.new_tensor(addition.scale * rank)
        tensors |= dict(zip((f"{name}.{f}" for f in _FACTORS), (addition.down, addition.up, alpha), strict=True))
    tensors |= delta.replaced
    assert delta.captions is not None and delta.texts is not None
    tensors |= {"captions.a2b": delta.captions[0], "captions.b2a": delta.captions[1]}
    header = {
        "format": FORMAT, "version": _VERSION, "architecture": model.architecture.name, "guide": delta.guide,
        "rank_unet": str(ranks["unet"]), "rank_vae": str(ranks["vae"]),
        "caption_a2b": delta.texts[0], "caption_b2a": delta.texts[1],
    }  # fmt: skip
    if model.seed is not None:
        header[RANDOM_BASE] = str(model.seed)
    if (record := record or model.record) is not None:
        header[TRAINING] = msgspec.json.encode(record).decode()
    header["tensors"] = json.dumps(sorted(tensors))
    save: Any = import_module("safetensors.torch").save_file
    plain = {name: each.detach().cpu().contiguous() for name, each in tensors.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        save(plain, temporary, metadata=header)
        _sort_header(temporary)


def read_own(
    tensors: Mapping[str, Tensor],
    metadata: Mapping[str, str],
    model: CycleGanTurbo,
    source: str,
    *,
    override: bool = False,
) -> AdapterWeights:
    """Read our format; raises ValueError for another version, architecture or base, and for unknown keys.

    `override` accepts another base of the same shapes.
    """
    _check_header(metadata, source)
    if metadata["architecture"] != model.architecture.name:
        raise ValueError(f"{source}: made for {metadata['architecture']}, not for {model.architecture.name}")
    probe = tensors.get(f"base.{_PROBE}")
    own = plain_tensors(model)[_PROBE].float().cpu()
    if probe is None or probe.shape != own.shape:
        raise ValueError(f"{source}: 'base.{_PROBE}' is missing or of another shape")
    if not override and float((probe.float() - own).abs().max()) > _PROBE_TOLERANCE * float(own.abs().max()):
        raise ValueError(f"{source}: made upon another base than this one; SD-Turbo of Stability AI is wanted")
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
    return AdapterWeights(
        source,
        additions,
        {name: tensors[name] for name in whole},
        "normals" if guide == "normals" else "mask" if guide == "mask" else "",
        (tensors["captions.a2b"], tensors["captions.b2a"]),
        (metadata["caption_a2b"], metadata["caption_b2a"]),
    )


def _check_header(metadata: Mapping[str, str], source: str) -> None:
    """Raise ValueError if the header of our file lacks a field, or has another version or architecture."""
    for field in ("version", "architecture", "guide", "caption_a2b", "caption_b2a", "tensors"):
        if field not in metadata:
            raise ValueError(f"{source}: {field!r} is missing from its header")
    if metadata["version"] != _VERSION:
        raise ValueError(f"{source}: version {metadata['version']}, this program reads {_VERSION}")
    if metadata["architecture"] not in ARCHITECTURES:
        raise ValueError(f"{source}: unknown architecture {metadata['architecture']!r}")
    if not metadata.get("random_base_seed", "0").isdecimal():
        raise ValueError(f"{source}: random_base_seed in its header is no number")


# Published checkpoints of img2img-turbo (clear2rainy.pkl and others) and of WeatherEdit

PUBLISHED = TrainingRecord(conditioning="none", normals="none", framing="stretch", width_px=512, height_px=512)
"""img2img-turbo's published weights, as its authors run them."""

_UNET_PARTS = {
    "encoder": "l_target_modules_encoder",
    "decoder": "l_target_modules_decoder",
    "other": "l_modules_others",
}
"""Parts of the UNet, and keys of the names of their layers."""
_OTHERS = ("rank_unet", "rank_vae", "vae_lora_target_modules", "sd_vae_enc", "sd_vae_dec")
_VAES = ("vae.", "vae_b2a.")
WEATHEREDIT_CAPTION = "Picture of a rainy weather scene"
_WEATHEREDIT = tuple(f"sd_{weather}_{part}" for weather in ("rainy", "snowy", "foggy") for part in _UNET_PARTS)
"""Keys of WeatherEdit's checkpoints, which hold several weathers that share an autoencoder."""


def published_texts(state: Mapping[str, Any]) -> tuple[str, str]:
    """Captions of the training; WeatherEdit has its own."""
    a2b, b2a = CAPTIONS
    return (WEATHEREDIT_CAPTION if "sd_rainy_encoder" in state else a2b), b2a


def read_published(state: Mapping[str, Any], model: CycleGanTurbo, source: str) -> AdapterWeights:
    """Read the weights of a checkpoint; of a file with several weathers, the LoRAs of rain.

    Raises ValueError with the `source` for missing and unknown keys and other shapes, naming the first.
    """
    several = [key for key in _WEATHEREDIT if key in state]
    parts = {f"sd_rainy_{part}" if several else f"sd_{part}": names for part, names in _UNET_PARTS.items()}
    expected = {*parts, *parts.values(), *_OTHERS}
    # Unknown plain values are training metadata; unknown tensors would be weights lost silently.
    heavy = {key for key, value in state.items() if isinstance(value, Mapping) or hasattr(value, "shape")}
    check_names((set(state) & expected) | heavy.difference(several), expected, source)
    additions: dict[str, LowRank] = {}
    rank = int(state["rank_unet"])
    for key, names in parts.items():
        where, layers = f"{source}: {key}", state[names]
        check_names(state[key], [f"{layer}.lora_{factor}.weight" for layer in layers for factor in "AB"], where)
        for layer in layers:
            down, up = (state[key][f"{layer}.lora_{factor}.weight"] for factor in "AB")
            if down.shape[0] != rank:
                raise ValueError(f"{where}: {layer!r} has rank {down.shape[0]}, not rank_unet, which is {rank}")
            additions[f"unet.{layer}"] = LowRank(down, up, 1.0)
    vae_additions, replaced = _autoencoders(state, model, source)
    guide: Guide = "mask" if replaced["vae.encoder.conv_in.weight"].shape[1] > 3 else ""
    return AdapterWeights(source, additions | vae_additions, replaced, guide, texts=published_texts(state))


def _autoencoders(
    state: Mapping[str, Any], model: CycleGanTurbo, source: str
) -> tuple[dict[str, LowRank], dict[str, Any]]:
    """LoRAs and whole tensors of both autoencoders; the file holds them twice, and the later copy counts."""
    layers = [name.removeprefix("vae.") for name in plain_layers(model) if name.startswith("vae.")]
    adapted = lora.match_targets(layers, state["vae_lora_target_modules"])
    tensors = [name.removeprefix("vae.").rpartition(".") for name in plain_tensors(model) if name.startswith("vae.")]
    stored = {  # names in the file, where peft has wrapped layers, by names in the model
        f"{prefix}{layer}.{tensor}": f"{prefix}{layer}{'.base_layer' if layer in adapted else ''}.{tensor}"
        for prefix in _VAES
        for layer, _, tensor in tensors
    }
    factors = {
        prefix + layer: [f"{prefix}{layer}.lora_{f}.{lora.VAE_ADAPTER}.weight" for f in "AB"]
        for prefix in _VAES
        for layer in adapted
    }
    for key in ("sd_vae_enc", "sd_vae_dec"):
        check_names(state[key], [*stored.values(), *chain(*factors.values())], f"{source}: {key}")
    found, scale = state["sd_vae_dec"], lora.VAE_ALPHA / int(state["rank_vae"])
    additions = {layer: LowRank(found[down], found[up], scale) for layer, (down, up) in factors.items()}
    return additions, {name: found[in_file] for name, in_file in stored.items()}


# LoRA files of diffusers (pytorch_lora_weights.safetensors) and of kohya's scripts, for the UNet alone

_PREFIX = "unet."
_FLAT_PREFIX = "lora_unet_"

_DIFFUSERS_FACTORS = {
    "lora_A.weight": "down", "lora_B.weight": "up",
    "lora.down.weight": "down", "lora.up.weight": "up",
    "lora_down.weight": "down", "lora_up.weight": "up",
    "alpha": "alpha",
}  # fmt: skip

_ENDING = re.compile(rf"\.({'|'.join(map(re.escape, _DIFFUSERS_FACTORS))})$")
_METADATA = "lora_adapter_metadata"  # header field in which diffusers writes peft's settings, in JSON


def read_diffusers_lora(
    tensors: Mapping[str, Tensor], metadata: Mapping[str, str], model: CycleGanTurbo, source: str
) -> AdapterWeights:
    """Read a LoRA file, scaled by alpha / rank, or by 1 without alpha.

    Raises ValueError with the first key that doesn't belong to the UNet, and for incomplete pairs of factors.
    """
    layers = {name.removeprefix(_PREFIX) for name in plain_layers(model) if name.startswith(_PREFIX)}
    shapes = {name: tuple(tensor.shape) for name, tensor in plain_tensors(model).items()}
    flat = {layer.replace(".", "_"): layer for layer in layers}
    found: dict[str, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        layer, factor = _named(name, layers, flat, source)
        found.setdefault(layer, {})[factor] = tensor
    settings = _settings(metadata, source)
    additions: dict[str, LowRank] = {}
    for layer, factors in found.items():
        for missing in {"down", "up"} - set(factors):
            raise ValueError(f"{source}: {layer!r} lacks its factor {missing!r}")
        down, up = factors["down"], factors["up"]
        rank = down.shape[0]
        alpha = float(factors["alpha"]) if "alpha" in factors else _alpha(settings, layer, rank)
        if len(shapes[f"{_PREFIX}{layer}.weight"]) == 2:  # files may store linear layers as 1x1 convolutions
            down, up = down.flatten(1), up.flatten(1)
        additions[_PREFIX + layer] = LowRank(down, up, alpha / rank)
    return AdapterWeights(source, additions, {})


def _named(name: str, layers: set[str], flat: Mapping[str, str], source: str) -> tuple[str, str]:
    ending = _ENDING.search(name)
    stem = name[: ending.start()] if ending else name
    layer = stem.removeprefix(_PREFIX) if stem.startswith(_PREFIX) else flat.get(stem.removeprefix(_FLAT_PREFIX), "")
    if ending is None or layer not in layers:
        raise ValueError(f"{source}: {name!r} is no addition to a layer of this UNet")
    return layer, _DIFFUSERS_FACTORS[ending[1]]


def _settings(metadata: Mapping[str, str], source: str) -> Mapping[str, Any]:
    try:
        settings: Any = json.loads(metadata.get(_METADATA, "{}"))
    except ValueError as error:
        raise ValueError(f"{source}: {_METADATA} in its header is not readable JSON: {error}") from error
    return {key.removeprefix(_PREFIX): value for key, value in settings.items() if key.startswith(_PREFIX)}


def _alpha(settings: Mapping[str, Any], layer: str, rank: int) -> float:
    pattern: Mapping[str, float] = settings.get("alpha_pattern") or {}
    found = (alpha for ending, alpha in pattern.items() if f".{layer}".endswith(f".{ending}"))
    return float(next(found, settings.get("lora_alpha", rank)))


_LENGTH_BYTES = 8


def _sort_header(file: Path) -> None:
    """Sort the header of a .safetensors file in place, since the library writes its fields in varying order.

    Equal weights give identical bytes then; tensor offsets stay.
    """
    with file.open("r+b") as stream:
        length = int.from_bytes(stream.read(_LENGTH_BYTES), "little")
        header: dict[str, Any] = json.loads(stream.read(length))
        fields = dict(sorted(header.pop("__metadata__", {}).items()))
        text = json.dumps({"__metadata__": fields, **header}, separators=(",", ":"), ensure_ascii=False).encode()
        if len(text) > length:
            raise ValueError(f"{file}: its header can't be written in {length} bytes")
        stream.seek(_LENGTH_BYTES)
        stream.write(text.ljust(length))
