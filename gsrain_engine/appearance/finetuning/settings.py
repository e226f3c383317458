"""What a person can choose about a fine-tuning of CycleGAN-Turbo: one value, which is also its YAML and its help."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from .pictures.settings import PictureSettings

Weight = Annotated[float, Meta(ge=0, le=100)]


class LossWeights(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How much each loss counts. The paper's three; those of LPIPS, where it is silent, are CycleGAN-Turbo's."""

    cycle: Annotated[Weight, Meta(title="Cycle", description="Mean difference after there and back again.")] = 1.0
    cycle_lpips: Annotated[Weight, Meta(title="Cycle, LPIPS", description="The same, as LPIPS sees it.")] = 10.0
    identity: Annotated[
        Weight, Meta(title="Identity", description="Mean difference of a picture that is already of the other look.")
    ] = 1.0
    identity_lpips: Annotated[Weight, Meta(title="Identity, LPIPS", description="The same, as LPIPS sees it.")] = 1.0
    gan: Annotated[Weight, Meta(title="GAN", description="What the discriminators tell apart.")] = 0.5


class OptimizerSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """AdamW (Loshchilov and Hutter 2019), of the generator and of the discriminators."""

    rate: Annotated[float, Meta(gt=0, le=1, title="Learning rate", description="Of the generator.")] = 1e-5
    discriminator_rate: Annotated[
        Annotated[float, Meta(gt=0, le=1)] | None,
        Meta(title="Discriminators' rate", description="Their learning rate; none: the generator's."),
    ] = None
    warmup_steps: Annotated[
        int, Meta(ge=0, title="Warm-up", description="Iterations in which the rates rise evenly; constant afterwards.")
    ] = 0
    beta_1: Annotated[float, Meta(ge=0, lt=1, title="Beta 1", description="Memory of the gradient's mean.")] = 0.9
    beta_2: Annotated[float, Meta(ge=0, lt=1, title="Beta 2", description="Memory of its square.")] = 0.999
    epsilon: Annotated[float, Meta(gt=0, le=1, title="Epsilon", description="Added to the square's root.")] = 1e-8
    weight_decay: Annotated[
        float,
        Meta(ge=0, le=1, title="Weight decay", description="Of what starts at nothing; pretrained layers have none."),
    ] = 1e-2
    clip_norm: Annotated[float, Meta(gt=0, title="Clipping", description="Longest gradient of all numbers.")] = 10.0


class LoraSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Size of what is learned (Hu et al. 2022)."""

    unet: Annotated[int, Meta(ge=1, le=1024, title="UNet rank", description="Of each layer's LoRA.")] = 128
    vae: Annotated[int, Meta(ge=1, le=1024, title="VAE rank", description="Of each layer's LoRA.")] = 4


class FinetuningSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How CycleGAN-Turbo is fine-tuned. The defaults are the paper's recipe; batches hold one picture of each look."""

    pictures: Annotated[PictureSettings, Meta(title="Pictures")]
    architecture: Annotated[
        Literal["sd-turbo", "tiny"],
        Meta(title="Architecture", description="tiny: the same layers, hardly any channels, to try a recipe on."),
    ] = "sd-turbo"
    base: Annotated[
        str | None,
        Meta(title="SD-Turbo", description="Folder of SD-Turbo; none: found by GSRAIN_SD_TURBO or the hub's cache."),
    ] = None
    clip: Annotated[
        str | None,
        Meta(
            title="CLIP", description="Folder of CLIP ViT-B/32, by which discriminators see; none: found like SD-Turbo."
        ),
    ] = None
    lpips: Annotated[
        str | None, Meta(title="LPIPS", description="File of LPIPS's VGG weights; none: those of this machine, if any.")
    ] = None
    start: Annotated[
        str | None,
        Meta(title="Start", description="Weights to go on from, such as clear2rainy.pkl; none: SD-Turbo itself."),
    ] = None
    steps: Annotated[
        int, Meta(ge=1, le=10_000_000, title="Steps", description="Iterations, each with one picture of each look.")
    ] = 20_000
    losses: Annotated[LossWeights, Meta(title="Losses")] = LossWeights()
    optimizer: Annotated[OptimizerSettings, Meta(title="Optimizer")] = OptimizerSettings()
    lora: Annotated[LoraSettings, Meta(title="LoRA")] = LoraSettings()
    augmentations: Annotated[
        tuple[Literal["color", "translation", "cutout"], ...],
        Meta(title="Augmentations", description="Done to whatever a discriminator sees, made and real alike."),
    ] = ("color", "translation", "cutout")
    gradient_checkpointing: Annotated[
        bool, Meta(title="Gradient checkpointing", description="Less memory for a third more time; the same numbers.")
    ] = False
    precision: Annotated[
        Literal["float32", "bfloat16"],
        Meta(
            title="Precision",
            description="bfloat16 halves memory, but is known to end in models that only reconstruct: their first "
            "changes are smaller than its steps.",
        ),
    ] = "float32"
    seed: Annotated[int, Meta(ge=0, le=2**31 - 1, title="Seed", description="Same seed, same bytes.")] = 0
    device: Annotated[
        Literal["auto", "cpu", "cuda"], Meta(title="Device", description="auto: CUDA where it is there.")
    ] = "auto"
    samples: Annotated[
        int, Meta(ge=1, le=16, title="Samples", description="So many clear pictures, of those for testing, are shown.")
    ] = 4
    sampled_every: Annotated[
        int, Meta(ge=0, title="Sampled every", description="Steps between grids of samples; 0: only at the end.")
    ] = 250
    saved_every: Annotated[
        int, Meta(ge=0, title="Saved every", description="Steps between checkpoints; 0: only at the end.")
    ] = 500
    warned_after: Annotated[
        int, Meta(ge=1, title="Warned after", description="Steps after which a model that only reconstructs is named.")
    ] = 500
