"""Settings, task and result of a fine-tuning of CycleGAN-Turbo, settings files, and the path of CLIP."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from ...presets import load_values, shipped_config_names
from ...safe_io.errors import convert_checked
from ...settings import Settings
from ..dsine_checkout import check_checkout, checkout_code

Weight = Annotated[float, Meta(ge=0, le=100)]


class ImageSource(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Images of one data set, filtered by its own weather labels."""

    # fmt: off
    path: Annotated[str, Meta(
        title="Path", description="Any capture, data set or folder of pictures.")]
    weather: Annotated[Literal["any", "clear", "rainy"], Meta(
        title="Weather", description="Only pictures that the data set labels so; any: all there are.")] = "any"
    daytime: Annotated[bool, Meta(
        title="Daytime", description="Leave out what is labelled as night or twilight.")] = True
    count: Annotated[Annotated[int, Meta(ge=1)] | None, Meta(
        title="Count", description="So many, spread evenly over its sequences; none: all.")] = None
    # fmt: on


class ImageSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Two unpaired sets of images, their framing, and the guide for the encoder's fourth channel."""

    # fmt: off
    clear: Annotated[tuple[ImageSource, ...], Meta(
        min_length=1, title="Clear", extra={"commands": "train-transfer"},
        description="Captures or folders of images in dry weather.")]
    rainy: Annotated[tuple[ImageSource, ...], Meta(
        min_length=1, title="Rainy", extra={"commands": "train-transfer"},
        description="Captures or folders of images in rain.")]
    test_share: Annotated[float, Meta(
        ge=0, lt=1, title="Test share", description="Share of each source that is never trained on.")] = 0.2
    width_px: Annotated[int, Meta(ge=16, le=4096, multiple_of=8, title="Width", extra={"unit": "px"})] = 512
    height_px: Annotated[int, Meta(ge=16, le=4096, multiple_of=8, title="Height", extra={"unit": "px"})] = 512
    framing: Annotated[Literal["stretch", "crop"], Meta(
        title="Framing",
        description="stretch: as the paper, whatever the proportions. crop: their middle.")] = "stretch"
    guide: Annotated[Literal["up", "luma", "none"], Meta(
        title="Guide", description="Fourth channel of the encoder: up-ness of surfaces, their luma, or none.")] = "up"
    normals: Annotated[str, Meta(
        title="Normals", extra={"commands": "train-transfer"},
        description="Source of normals for pictures without depth: dsine, marigold, none.")] = "none"
    normals_weights: Annotated[str | None, Meta(
        title="Weights for normals", extra={"commands": "train-transfer"},
        description="File of DSINE (none: see gsrain doctor), or folder of Marigold.")] = None
    normals_checkout: Annotated[str | None, Meta(
        title="Checkout for normals", extra={"commands": "train-transfer"},
        description="Your own copy of DSINE's program; none: see gsrain doctor.")] = None
    seed: Annotated[int, Meta(
        ge=0, le=2**31 - 1, title="Seed", description="Seed that draws the test pictures.")] = 0
    # fmt: on


class LossWeights(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Loss weights: the paper's three; those of LPIPS, which it doesn't give, are CycleGAN-Turbo's."""

    # fmt: off
    cycle: Annotated[Weight, Meta(
        title="Cycle", description="Mean difference after there and back again.")] = 1.0
    cycle_lpips: Annotated[Weight, Meta(
        title="Cycle, LPIPS", description="The same, as LPIPS sees it.")] = 10.0
    identity: Annotated[Weight, Meta(
        title="Identity", description="Mean difference of a picture that is already of the other look.")] = 1.0
    identity_lpips: Annotated[Weight, Meta(
        title="Identity, LPIPS", description="The same, as LPIPS sees it.")] = 1.0
    gan: Annotated[Weight, Meta(
        title="GAN", description="Weight of the adversarial loss.")] = 0.5
    # fmt: on


class OptimizerSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """AdamW (Loshchilov and Hutter 2019) for the generator and the discriminators."""

    # fmt: off
    rate: Annotated[float, Meta(
        gt=0, le=1, title="Learning rate", description="Of the generator.")] = 1e-5
    discriminator_rate: Annotated[Annotated[float, Meta(gt=0, le=1)] | None, Meta(
        title="Discriminators' rate", description="Their learning rate; none: the generator's.")] = None
    warmup_steps: Annotated[int, Meta(
        ge=0, title="Warm-up", description="Iterations in which the rates rise evenly; constant afterwards.")] = 0
    beta_1: Annotated[float, Meta(
        ge=0, lt=1, title="Beta 1", description="Memory of the gradient's mean.")] = 0.9
    beta_2: Annotated[float, Meta(
        ge=0, lt=1, title="Beta 2", description="Memory of its square.")] = 0.999
    epsilon: Annotated[float, Meta(
        gt=0, le=1, title="Epsilon", description="Added to the square's root.")] = 1e-8
    weight_decay: Annotated[float, Meta(
        ge=0, le=1, title="Weight decay",
        description="Of what starts at nothing; pretrained layers have none.")] = 1e-2
    clip_norm: Annotated[float, Meta(
        gt=0, title="Clipping", description="Longest gradient of all numbers.")] = 10.0
    # fmt: on


class LoraSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """LoRA ranks (Hu et al. 2022)."""

    # fmt: off
    unet: Annotated[int, Meta(
        ge=1, le=1024, title="UNet rank", description="Of each layer's LoRA.")] = 128
    vae: Annotated[int, Meta(
        ge=1, le=1024, title="VAE rank", description="Of each layer's LoRA.")] = 4
    # fmt: on


class FinetuningSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of a fine-tuning. The defaults are the paper's recipe; batches hold one image of each look."""

    # fmt: off
    pictures: Annotated[ImageSettings, Meta(title="Pictures")]
    architecture: Annotated[Literal["sd-turbo", "tiny"], Meta(
        title="Architecture",
        description="tiny: the same layers, hardly any channels, to try a recipe on.")] = "sd-turbo"
    base: Annotated[str | None, Meta(
        title="SD-Turbo", extra={"commands": "train-transfer"},
        description="Folder of SD-Turbo; none: found by GSRAIN_SD_TURBO or the hub's cache.")] = None
    clip: Annotated[str | None, Meta(
        title="CLIP", extra={"commands": "train-transfer"},
        description="Folder of CLIP ViT-B/32, by which discriminators see; none: found like SD-Turbo.")] = None
    lpips: Annotated[str | None, Meta(
        title="LPIPS", extra={"commands": "train-transfer"},
        description="File of LPIPS's VGG weights; none: those of this machine, if any.")] = None
    start: Annotated[str | None, Meta(
        title="Start", extra={"commands": "train-transfer"},
        description="Weights to go on from, such as clear2rainy.pkl; none: SD-Turbo itself.")] = None
    steps: Annotated[int, Meta(
        ge=1, le=10_000_000, title="Steps", extra={"commands": "train-transfer"},
        description="Iterations, each with one picture of each look.")] = 20_000
    losses: Annotated[LossWeights, Meta(title="Losses")] = LossWeights()
    optimizer: Annotated[OptimizerSettings, Meta(title="Optimizer")] = OptimizerSettings()
    lora: Annotated[LoraSettings, Meta(title="LoRA")] = LoraSettings()
    augmentations: Annotated[tuple[Literal["color", "translation", "cutout"], ...], Meta(
        title="Augmentations",
        description="Done to whatever a discriminator sees, made and real alike.",
    )] = ("color", "translation", "cutout")
    gradient_checkpointing: Annotated[bool, Meta(
        title="Gradient checkpointing", description="Less memory for a third more time; the same numbers.")] = False
    precision: Annotated[Literal["float32", "bfloat16"], Meta(
        title="Precision",
        description="bfloat16 halves memory, but is known to end in models that only reconstruct: their first "
        "changes are smaller than its steps.")] = "float32"
    seed: Annotated[int, Meta(
        ge=0, le=2**31 - 1, title="Seed", extra={"commands": "train-transfer"},
        description="Same seed, same bytes (on the CPU).")] = 0
    device: Annotated[Literal["auto", "cpu", "cuda"], Meta(
        title="Device", extra={"commands": "train-transfer"}, description="auto: CUDA where it is there.")] = "auto"
    samples: Annotated[int, Meta(
        ge=1, le=16, title="Samples", description="So many clear pictures, of those for testing, are shown.")] = 4
    sampled_every: Annotated[int, Meta(
        ge=0, title="Sampled every", description="Steps between grids of samples; 0: only at the end.")] = 250
    saved_every: Annotated[int, Meta(
        ge=0, title="Saved every", description="Steps between checkpoints; 0: only at the end.")] = 500
    warned_after: Annotated[int, Meta(
        ge=1, title="Warned after", description="Steps after which a model that only reconstructs is named.")] = 500
    # fmt: on


# Task and result, as plain values


class FinetuneTask(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fine-tuning job; picklable for a worker process."""

    settings: FinetuningSettings
    output: Path
    resume: bool = False
    """Continue from the folder's checkpoint."""
    code: dict[str, str] = msgspec.field(default_factory=dict)
    """Digests of Python code that the settings name and the user has allowed, by path."""

    @property
    def weights(self) -> Path:
        """Path of the weights for `gsrain transfer --weights`; written with each checkpoint."""
        return self.output / "weights.safetensors"

    @property
    def checkpoint(self) -> Path:
        return self.output / "checkpoint.safetensors"

    @property
    def config(self) -> Path:
        return self.output / "config.yaml"

    @property
    def losses(self) -> Path:
        """Path of the loss log; `loss_log.read_losses` can read it during training."""
        return self.output / "losses.csv"

    @property
    def samples(self) -> Path:
        """Folder of sample grids, `step_000250.png` and so on."""
        return self.output / "samples"

    @property
    def images_cache(self) -> Path:
        """Cache folder for estimated guides."""
        return self.output / "guides"


@dataclass(frozen=True, slots=True, eq=False)
class FinetuneResult:
    """Files and statistics of a finished fine-tuning."""

    weights: Path
    grid: Path
    steps: int
    seconds: float
    losses: dict[str, float]
    """Means over the last hundred iterations."""
    share: float
    """Change by the translation as a share of the distance between the looks."""
    warning: str | None
    perceptual: bool
    """True if LPIPS was one of the losses."""
    table: tuple[tuple[str, str, int, int], ...]
    """One row per source: path, clear or rainy, number of images, number of test images."""
    problems: tuple[str, ...]

    @property
    def numbers(self) -> dict[str, Any]:
        pictures = [
            {"path": path, "look": look, "count": count, "tested": tested} for path, look, count, tested in self.table
        ]
        return {
            "steps": self.steps, "seconds": self.seconds, "losses": self.losses, "share_of_distance": self.share,
            "warning": self.warning, "lpips": self.perceptual, "weights": str(self.weights),
            "pictures": pictures, "problems": list(self.problems),
        }  # fmt: skip


# Settings files: shipped ones by name, the user's by path, with changes applied on top

_FOLDER = "finetune"
_NORMALS = ("normals", "normals_weights", "normals_checkout")
_FILES = ("path", "normals_weights", "normals_checkout", "base", "clip", "lpips", "start")


def load_finetuning(name: str | Path, **changes: Any) -> FinetuningSettings:
    """Read settings and apply changes; changes that are None are ignored.

    Relative paths are resolved against the settings file's folder first, then the working folder. Raises ValueError
    with the file or option, the field and the allowed values; `UntrustedCodeError` if they name code that the user has
    not allowed to run.
    """
    values = load_values(_FOLDER, name, "settings", _FILES)
    changed = {key: value for key, value in changes.items() if value is not None}
    if isinstance(pictures := values.get("pictures", {}), dict):
        sources = {
            look: _in_place(pictures.get(look), changed.pop(look)) for look in ("clear", "rainy") if look in changed
        }
        own = {name: changed.pop(name) for name in _NORMALS if name in changed}
        values["pictures"] = pictures | sources | own
    try:
        settings: FinetuningSettings = convert_checked(values | changed, FinetuningSettings)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    check_checkout(name, settings.pictures.normals, settings.pictures.normals_checkout)
    return settings


def _in_place(rows: object, given: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Sources with other places: the first keeps weather and number of the first of the settings, and so on."""
    own = [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    return [{**(own[place] if place < len(own) else {}), **each} for place, each in enumerate(given)]


def code_of(settings: FinetuningSettings) -> dict[str, str]:
    """Digests of the Python code that settings name, by absolute path: for the process that runs it."""
    pictures = settings.pictures
    if pictures.normals != "dsine" or pictures.normals_checkout is None:
        return {}
    code = checkout_code(Path(pictures.normals_checkout))
    return {str(code.path): code.digest}


def finetuning_names() -> list[str]:
    return shipped_config_names(_FOLDER)


# Path of CLIP's vision model for the discriminators. Needs no torch.

PLACE = "GSRAIN_CLIP"
"""Environment variable with the folder of CLIP ViT-B/32 in the layout of transformers."""
_HUB_NAME = "openai/clip-vit-base-patch32"
_OWN = "clip-vit-base-patch32"


def find_clip(folder: Path | None = None) -> Path:
    """Find CLIP's folder: `folder`, else that of GSRAIN_CLIP, else in the data folder or Hugging Face's cache.

    Raises FileNotFoundError with the folders searched and download instructions.
    """
    from ..cyclegan_turbo.weight_paths import data_folder, hub_snapshots  # loads NumPy, which help does without

    named = folder or os.environ.get(PLACE)
    places = (Path(named),) if named else (data_folder() / _OWN, *hub_snapshots(_HUB_NAME))
    for place in places:
        if (place / "config.json").is_file():
            return place
    looked = " and ".join(map(str, places))
    raise FileNotFoundError(
        f"no CLIP ViT-B/32 (config.json) at {looked}: hf download {_HUB_NAME} --local-dir {data_folder() / _OWN} "
        f"(600 MB; huggingface-cli download in older versions), or name its folder by --clip or {PLACE}"
    )
