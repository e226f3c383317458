"""Settings of a recoloring and of its color solver."""

from typing import Annotated

import msgspec
from msgspec import Meta

from ..settings import Settings


class RecolorSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the color solver."""

    iterations: Annotated[int, Meta(
        ge=1, le=200, title="Iterations", extra={"commands": "recolor, bench recoloring"},
        description="Steps of conjugate gradients, in total.")] = 12  # fmt: skip
    rounds: Annotated[int, Meta(ge=1, le=10, title="Rounds")] = 2
    """Number of times that exposures and trust are re-estimated; the iterations are divided among them."""
    sh_degree: Annotated[int, Meta(
        ge=0, le=3, title="Degree of harmonics", extra={"commands": "recolor"},
        description="Highest degree of harmonics to solve for; never above the scene's own.")] = 3  # fmt: skip
    tikhonov: Annotated[float, Meta(ge=1e-6, le=1e6)] | None = None
    """Prior weight of the mapped clear colors: the evidence at which a Gaussian moves halfway; None selects it by
    cross-validation."""
    directional: Annotated[float, Meta(ge=0, le=1e3, title="Pull on directions")] = 4.0
    """Factor of the prior weight on each harmonic above degree 0."""
    per_view: Annotated[float, Meta(ge=0, le=10, title="Pull by views")] = 0.1
    """Extra prior weight above degree 0 as a share of one view's evidence, since one view can't separate directions."""
    exposure: Annotated[bool, Meta(
        title="Exposures", extra={"commands": "recolor"},
        description="Fit an exposure and white balance for each image.")] = True  # fmt: skip
    robust: Annotated[bool, Meta(
        title="Robust", extra={"commands": "recolor"},
        description="Reduce the weight of images and pixels that disagree with the others.")] = True  # fmt: skip
    memory_mb: Annotated[float, Meta(
        ge=0, title="Memory", extra={"unit": "MB", "commands": "recolor"},
        description="Memory for stored weights; views beyond it take longer; 0: all do.")] = 4096.0  # fmt: skip
    """Views beyond it recompute their tiles on each use. With 0, solving the street with 24
    views of 640 px took 7 times as long in total, 1.2 times the CPU time, and 0.73 of the memory."""


class RecolorOptions(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of a recoloring besides those of the solver."""

    # fmt: off
    width_px: Annotated[int, Meta(
        ge=16, le=16384, title="Width of pictures", extra={"unit": "px", "commands": "recolor"},
        description="Wider images are downscaled to this width.")] = 960
    held_out: Annotated[int, Meta(
        ge=0, title="Held out", extra={"commands": "recolor"},
        description="Hold out every Nth view for measuring; 0: none.")] = 8
    polish: Annotated[int, Meta(
        ge=0, le=100_000, title="Polish steps", extra={"option": "photometric-steps", "commands": "recolor"},
        description="Final steps on absolute differences and structure (D-SSIM), of colors alone; needs torch.")] = 0
    refine: Annotated[int, Meta(
        ge=0, le=100_000, title="Refine steps", extra={"on": 300, "commands": "recolor"},
        description="Final steps that train all parameters; needs torch.")] = 0
    replace_clear: Annotated[bool, Meta(
        title="Replace clear colors", extra={"option": "replace", "commands": "recolor"},
        description="Replace the clear colors instead of adding wet ones.")] = False
    # fmt: on
    colors: RecolorSettings = msgspec.field(default_factory=RecolorSettings)
