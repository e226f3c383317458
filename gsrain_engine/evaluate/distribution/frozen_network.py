"""Networks that only look: made without first numbers, filled with given ones, never trained."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

import numpy as np

torch: Any = import_module("torch")

Tensor = Any


class FrozenNorm(torch.nn.Module):
    """Batch normalization with given statistics, named as torch names them; epsilon is TensorFlow's, 0.001."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        for name in ("weight", "bias", "running_mean", "running_var"):
            self.register_buffer(name, torch.zeros(channels))

    def forward(self, flow: Tensor) -> Tensor:
        """Return the normalized flow (b, channels, h, w)."""
        scales = (self.running_mean, self.running_var, self.weight, self.bias)
        return torch.nn.functional.batch_norm(flow, *scales, eps=1e-3)


def hollow(make: Callable[[], Any]) -> Any:
    """Make a network whose parts have names and shapes but no numbers, which costs next to nothing."""
    with torch.device("meta"):
        return make()


def filled(make: Callable[[], Any], arrays: Mapping[str, np.ndarray]) -> Any:
    """Make a network of exactly these arrays, by name. Raises RuntimeError where names or shapes differ."""
    network = hollow(make)
    network.load_state_dict({name: torch.from_numpy(array.copy()) for name, array in arrays.items()}, assign=True)
    return network.requires_grad_(False).eval()
