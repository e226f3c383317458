"""Affine maps of colour, one a picture: what a camera's exposure and white balance did to it."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Shaped

torch: Any = import_module("torch")

Tensor = Any

_DECAYS = 0.9, 0.999


class ExposureAffine:
    """Trainable maps color -> A color + b of all pictures; their mean is no change, which fixes the gauge.

    Without the gauge the scene could turn darker and every picture lighter, and nobody would know the difference.
    """

    def __init__(self, count: int, device: str = "cpu") -> None:
        self.changes = torch.zeros((count, 3, 4), device=device, requires_grad=True)
        """(count, 3, 4): what is added to the identity."""
        self._first, self._second = torch.zeros((2, count, 3, 4), device=device).unbind()
        self._steps = 0

    def apply(self, index: int, color: Tensor) -> Tensor:
        """Map a picture's colours (h, w, 3) as its camera would have."""
        change = self.changes[index]
        return color + color @ change[:, :3].T + change[:, 3]

    def pull(self, index: int) -> Tensor:
        """Sum of squares of one picture's change: 0 where there is none."""
        return (self.changes[index] ** 2).sum()

    def step(self, rate: float) -> None:
        """Do one step of Adam, then bring the mean over all pictures back to no change."""
        slope = self.changes.grad
        if slope is None:
            return
        self._steps += 1
        with torch.no_grad():
            self._first.mul_(_DECAYS[0]).add_(slope, alpha=1 - _DECAYS[0])
            self._second.mul_(_DECAYS[1]).addcmul_(slope, slope, value=1 - _DECAYS[1])
            shares = [1 - decay**self._steps for decay in _DECAYS]
            self.changes.addcdiv_(self._first / shares[0], (self._second / shares[1]).sqrt() + 1e-15, value=-rate)
            self.changes -= self.changes.mean(dim=0, keepdim=True)
        self.changes.grad = None

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        tensors = {"changes": self.changes, "first": self._first, "second": self._second}
        arrays = {name: each.detach().cpu().numpy().copy() for name, each in tensors.items()}
        return arrays | {"steps": np.array(self._steps)}

    def restore(self, state: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
        """Go back to what `state` returned; raises KeyError where something is missing."""
        device = self.changes.device
        self.changes = torch.tensor(state["changes"], device=device, requires_grad=True)
        self._first = torch.tensor(state["first"], device=device)
        self._second = torch.tensor(state["second"], device=device)
        self._steps = int(state["steps"])
