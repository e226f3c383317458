"""Features of views that are already in the network or through it, kept for those that look at them."""

from importlib import import_module
from typing import Any

from jaxtyping import Bool, Float32
from numpy import ndarray

from .window import Window

torch: Any = import_module("torch")

Tensor = Any


class FeatureMaps:
    """Maps (channels, height, width) over whole pictures, by view and layer; tiles are put together, averaged."""

    def __init__(self) -> None:
        self._sums: dict[tuple[int, str], Tensor] = {}
        self._weights: dict[tuple[int, str], Tensor] = {}

    def put(self, view: int, layer: str, features: Tensor, window: Window) -> None:
        """Keep (tokens, channels) of a window, which is in tokens."""
        part = features.detach().T.reshape(-1, window.height, window.width)
        key = (view, layer)
        if window.is_whole:
            self._sums[key] = part
            return
        if key not in self._sums:
            self._sums[key] = part.new_zeros((part.shape[0], *window.frame))
            self._weights[key] = part.new_zeros(window.frame)
        rows, columns = slice(window.top, window.top + window.height), slice(window.left, window.left + window.width)
        self._sums[key][:, rows, columns] += part
        self._weights[key][rows, columns] += 1

    def warped(
        self, view: int, layer: str, grid: Float32[ndarray, "h w 2"], valid: Bool[ndarray, "h w"]
    ) -> Tensor | None:
        """Return (valid tokens, channels) of a view's map at places as `grid_sample` takes them; None without map."""
        features = self._sums.get((view, layer))
        if features is None:
            return None
        if (weights := self._weights.get((view, layer))) is not None:
            features = features / weights.clamp_min(1)
        places = torch.from_numpy(grid[valid])[None, None].to(features.device)
        # float32 also for half-precision networks: a place in a map needs more than 11 bits.
        found = torch.nn.functional.grid_sample(
            features[None].float(), places, mode="bilinear", padding_mode="border", align_corners=False
        )
        return found[0, :, 0].T.to(features.dtype)

    def forget(self, views: set[int]) -> None:
        """Let the maps of these views go."""
        for maps in (self._sums, self._weights):
            for key in [key for key in maps if key[0] in views]:
                del maps[key]

    @property
    def nbytes(self) -> int:
        return sum(m.numel() * m.element_size() for maps in (self._sums, self._weights) for m in maps.values())
