"""The one step of SD-Turbo: a clean latent from the noise that the UNet finds in it, in closed form."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .architecture import TurboArchitecture

Tensor = Any


@dataclass(frozen=True, slots=True)
class OneStep:
    """The step from the last of the noise steps straight to a clean latent."""

    timestep: int
    """999 in SD-Turbo: with "trailing" spacing a schedule of one step starts at the end; "leading" would give 0."""
    signal: float
    """Share of the clean latent at that step, a standard deviation."""
    noise: float
    """Share of the noise, likewise."""

    @classmethod
    def of(cls, architecture: TurboArchitecture) -> "OneStep":
        """Work the shares out of the noise schedule (Ho et al. 2020, eq. 4; betas "scaled linear")."""
        first, last = architecture.betas
        betas = np.linspace(first**0.5, last**0.5, architecture.noise_steps) ** 2
        kept = float(np.prod(1 - betas))
        return cls(architecture.noise_steps - 1, kept**0.5, (1 - kept) ** 0.5)

    def clean(self, latents: Tensor, noise: Tensor) -> Tensor:
        """Latents without the noise that the UNet predicts for them, as DDPM's step gives (Ho et al. 2020, eq. 15).

        An error in the noise comes out 15 times as large (`noise / signal`), so this is reckoned in float32 at least.
        The UNet's own rounding is amplified all the same: in a small random one bfloat16 is 1.2 % off and float16
        0.15 %, which makes 17 % and 2 % of a latent's deviation.
        """
        clean = (latents.float() - self.noise * noise.float()) / self.signal
        return clean.to(latents.dtype)
