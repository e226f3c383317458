"""Settings of a reconstruction, with their YAML files and help texts."""

from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta

from ..presets import load_values, shipped_config_names
from ..safe_io.errors import convert_checked
from ..settings import Settings

_FOLDER = "reconstruct"
Weight = Annotated[float, Meta(ge=0, le=100)]
Rate = Annotated[float, Meta(gt=0, le=1)]


class LearningRates(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Adam learning rate of each parameter (3D Gaussian Splatting, Kerbl et al. 2023, section 5 and their code)."""

    means: Annotated[Rate, Meta(title="Means", description="At the first step, times the extent of the cameras.")] = (
        1.6e-4
    )
    last_means: Annotated[
        Rate, Meta(title="Means at the end", description="At the last step, times the extent; exponential between.")
    ] = 1.6e-6
    log_scales: Annotated[Rate, Meta(title="Scales", description="Of the logarithm of the scales.")] = 5e-3
    quaternions: Annotated[Rate, Meta(title="Rotations", description="Of the unnormalized quaternions.")] = 1e-3
    opacity_logits: Annotated[Rate, Meta(title="Opacities", description="Of the opacities' logits.")] = 5e-2
    sh_dc: Annotated[Rate, Meta(title="Colors", description="Of the harmonics of degree 0.")] = 2.5e-3
    sh_rest: Annotated[Rate, Meta(title="Directional colors", description="Of the harmonics above degree 0.")] = 1.25e-4
    exposure: Annotated[Rate, Meta(title="Exposures", description="Of each picture's affine map of colors.")] = 1e-3


class TrainingSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the fit of Gaussians to images. Defaults take about ten minutes on a two-core CPU."""

    # fmt: off
    steps: Annotated[int, Meta(
        ge=1, le=1_000_000, title="Steps", extra={"commands": "reconstruct"},
        description="Number of training steps; each renders one view.")] = 2000
    width_px: Annotated[int, Meta(
        ge=16, le=16384, title="Width", extra={"unit": "px", "commands": "reconstruct"},
        description="Pictures wider than this are made smaller, lens distortion removed.")] = 480
    keep_lenses: Annotated[bool, Meta(
        title="Keep lenses", extra={"commands": "reconstruct"},
        description="Cameras of the scene's rig keep the lenses of the capture; they are pinholes otherwise.")] = False
    gaussians: Annotated[int, Meta(
        ge=100, le=100_000_000, title="Gaussians", extra={"commands": "reconstruct"},
        description="Most there may be in the static scene.")] = 120_000
    density: Annotated[Literal["adaptive", "mcmc"], Meta(
        title="Density control", extra={"commands": "reconstruct"},
        description="adaptive: clone, split and prune (3DGS). mcmc: relocate and explore (3DGS-MCMC).")] = "adaptive"
    sh_degree: Annotated[int, Meta(
        ge=0, le=3, title="SH degree", extra={"commands": "reconstruct"},
        description="Highest degree of the harmonics; low for few views.")] = 1
    held_out: Annotated[int, Meta(
        ge=0, le=10_000, title="Held out", extra={"commands": "reconstruct"},
        description="Keep every Nth view for measuring; 0: none.")] = 8
    held_out_views: Annotated[tuple[str, ...], Meta(
        title="Held-out views", extra={"option": "held-out", "commands": "reconstruct"},
        description="Or these views, by name.")] = ()
    seed: Annotated[int, Meta(
        ge=0, le=2**31 - 1, title="Seed", extra={"commands": "reconstruct"},
        description="Same seed, same bytes (on the CPU).")] = 0
    rates: Annotated[LearningRates, Meta(title="Learning rates")] = LearningRates()
    haste: Annotated[float, Meta(
        ge=0.1, le=20, title="Haste", description="Multiplies the learning rates of a run that is short.")] = 3.0
    d_ssim: Annotated[float, Meta(
        ge=0, le=1, title="D-SSIM", description="Share of structural dissimilarity in the loss; rest L1.")] = 0.2
    depth: Annotated[Weight, Meta(
        title="Depth", description="Weight of the relative error of depth where it was measured; 0: off.")] = 0.1
    cover: Annotated[Weight, Meta(
        title="Cover", description="Weight of holes before what has a depth, and of veils before the sky.")] = 0.05
    free_space: Annotated[float, Meta(
        ge=0, le=0.9, title="Free space",
        description="Share of the way to what a camera sees that must be empty, where depth is known; 0: off.")] = 0.2
    transients: Annotated[float, Meta(
        ge=0, le=0.5, title="Transients",
        description="Most of a picture that is left out late where it contradicts the others; for captures without "
        "boxes of what moves. 0: off.")] = 0.1
    exposure: Annotated[Weight, Meta(
        title="Exposure", description="Pull of each picture's affine map of colors to none; 0: no maps.")] = 0.5
    coarse: Annotated[float, Meta(
        ge=0, le=1, title="Coarse",
        description="Share of the steps with small pictures: first a quarter of the size, then half.")] = 0.1
    sky: Annotated[bool, Meta(
        title="Sky", description="Fit a dome of far Gaussians where the sky is.")] = True
    own_body: Annotated[bool | None, Meta(
        title="Own body", extra={"commands": "reconstruct"},
        description="Look for the vehicle's own body in the pictures, and leave it out; none: where the capture is a "
        "drive (a rig on a vehicle, or odometry).")] = None
    actors: Annotated[bool, Meta(
        title="Actors", description="Fit what moves as objects of their own; else it is left out.")] = True
    measured_every: Annotated[int, Meta(
        ge=0, le=1_000_000, title="Measured every", description="Steps between looks at held-out views.")] = 300
    saved_every: Annotated[int, Meta(
        ge=0, le=1_000_000, title="Saved every", description="Steps between checkpoints; 0: none.")] = 200
    device: Annotated[Literal["auto", "cpu", "cuda"], Meta(
        title="Device", extra={"commands": "reconstruct"},
        description="auto: CUDA where it and gsplat are there.")] = "auto"
    # fmt: on


def load_settings(name: str | Path | None = None, **changes: Any) -> TrainingSettings:
    """Read shipped settings by name, or a YAML file by path, and change some; without a name the defaults.

    Changes that are None are ignored. Raises ValueError with the file or option, the field and the allowed values.
    """
    values = {} if name is None else load_values(_FOLDER, name, "--config")
    changed = {key: value for key, value in changes.items() if value is not None}
    try:
        convert_checked(values, TrainingSettings)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    return convert_checked(values | changed, TrainingSettings)


def settings_names() -> list[str]:
    return shipped_config_names(_FOLDER)
