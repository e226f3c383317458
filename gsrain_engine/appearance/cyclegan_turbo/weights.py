"""Files of CycleGAN-Turbo's weights, in whatever layout: read strictly into a model, and written in our own."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from gsrain_engine.untrusted.limits import check_file, open_file
from gsrain_engine.untrusted.printable import printable

from .delta import TurboDelta
from .diffusers_lora_weights import is_diffusers_lora, read_diffusers_lora
from .model import CycleGanTurbo
from .own_weights import check_header, is_own, read_own, write_own
from .published_weights import is_published, published_texts, read_published

torch: Any = import_module("torch")

Tensor = Any


@dataclass(frozen=True, slots=True, eq=False)
class WeightsFile:
    """What a file holds, before it is known which model it goes into."""

    path: Path
    state: Mapping[str, Any]
    metadata: Mapping[str, str]
    """Header of a .safetensors."""

    @property
    def architecture(self) -> str:
        return self.metadata.get("architecture", "sd-turbo")

    @property
    def random_base_seed(self) -> int | None:
        """Of the random weights that it was trained upon, in tests; None for SD-Turbo."""
        seed = self.metadata.get("random_base_seed")
        return None if seed is None else int(seed)

    @property
    def takes_guides(self) -> bool:
        """Whether it was made with a fourth channel."""
        state: Any = self.state.get("sd_vae_dec", self.state)
        ends = ("vae.encoder.conv_in.weight", "vae.encoder.conv_in.base_layer.weight")
        kernels = [state[name] for name in ends if isinstance(state, Mapping) and name in state]
        return any(len(shape) > 1 and shape[1] > 3 for shape in (getattr(each, "shape", ()) for each in kernels))

    def texts(self, weather: str = "rainy") -> tuple[str, str] | None:
        """Captions that the text encoder has to encode, for a2b and b2a; None where the file has their embeddings."""
        return None if is_own(self.metadata) else published_texts(self.state, weather)

    def delta(self, model: CycleGanTurbo, weather: str = "rainy") -> TurboDelta:
        """What the file adds to SD-Turbo; raises ValueError, with the first bad key, where it isn't for this model."""
        try:
            return self._delta(model, weather)
        except ValueError as error:
            raise ValueError(printable(error)) from None
        except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError) as error:
            # A value where a tensor belongs, a tensor where a number belongs: whatever damage has put there.
            words = printable(str(error).split("\n")[0])
            raise ValueError(f"{self.path}: its weights are damaged: {words or type(error).__name__}") from None

    def _delta(self, model: CycleGanTurbo, weather: str) -> TurboDelta:
        source = str(self.path)
        if is_own(self.metadata):
            return read_own(self.state, self.metadata, model, source)
        if is_published(self.state):
            return read_published(self.state, model, source, weather)
        if is_diffusers_lora(self.state):
            return read_diffusers_lora(self.state, self.metadata, model, source)
        some = ", ".join(repr(name) for name in sorted(self.state)[:3])
        raise ValueError(f"{source}: neither img2img-turbo's, WeatherEdit's, a LoRA nor our own weights: has {some}")


def open_weights(path: Path) -> WeightsFile:
    """Read a .pkl (as weights only: no code of it runs) or a .safetensors.

    Raises FileNotFoundError, and ValueError with the file's name where it can't be read.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file of weights")
    if path.suffix == ".safetensors":
        state, metadata = _safetensors(path)
        if is_own(metadata):
            check_header(metadata, str(path))
        return WeightsFile(path, state, metadata)
    try:
        with open_file(path) as stream:
            state = torch.load(stream, map_location="cpu", weights_only=True)
    except Exception as error:  # torch fails in many ways; its words are the finding
        first = str(error).split("\n")[0].strip() or type(error).__name__
        raise ValueError(f"{path}: not a readable file of torch weights: {printable(first)}") from None
    if not isinstance(state, Mapping):
        raise ValueError(f"{path}: holds {type(state).__name__}, not weights by name")
    return WeightsFile(path, dict(state.items()), {})


def save_weights(model: CycleGanTurbo, path: Path) -> None:
    """Write everything that a model has beyond SD-Turbo to a .safetensors: additions, first convolutions, captions.

    Raises ValueError for another suffix, and where there is nothing to save.
    """
    if path.suffix != ".safetensors":
        raise ValueError(f"{path}: weights are written as .safetensors")
    write_own(model, path)


def _safetensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    try:
        safetensors: Any = import_module("safetensors")
    except ModuleNotFoundError as error:
        raise ValueError(f"{path}: reading it takes safetensors: pip install 'gsrain[diffusion]'") from error
    try:
        check_file(path)
        with safetensors.safe_open(path, framework="pt") as file:
            names: list[str] = file.keys()
            return {name: file.get_tensor(name) for name in names}, dict(file.metadata() or {})
    except (safetensors.SafetensorError, AttributeError, OSError, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not a readable .safetensors: {printable(error)}") from None
