"""What views say to each other while they go through a network: installed into it, and taken out again."""

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from importlib import import_module
from typing import Any

from jaxtyping import Bool, Float32
from numpy import ndarray

from gsrain_engine.appearance.matching.correspondence import Correspondence

from .features import FeatureMaps
from .processor import MutualSelfAttention
from .settings import MutualAttention
from .window import Window

torch: Any = import_module("torch")

Tensor = Any


@dataclass(frozen=True, slots=True, eq=False)
class Element:
    """One entry of a batch: a view, or a tile of one."""

    view: int
    window: Window
    sources: tuple[tuple[int, Correspondence], ...] = ()
    """Views that it looks at, each with the places of this view's pixels in it."""
    is_source: bool = False
    """Whether any view looks at this one."""


class Exchange:
    """Knows what is in the batch, keeps features of views, and hands each layer what its queries may also look at."""

    def __init__(self, settings: MutualAttention) -> None:
        self.settings = settings
        self.maps = FeatureMaps()
        self._elements: tuple[Element, ...] = ()
        self._latent: tuple[int, int] = (0, 0)
        self._grids: dict[tuple[int, int, int, int], tuple[Float32[ndarray, "_ _ 2"], Bool[ndarray, "_ _"]]] = {}

    @contextmanager
    def batch(self, elements: Sequence[Element]) -> Generator[None]:
        """Tell what the next pass through the network is made of; outside of it attention is the plain one."""
        self._elements = tuple(elements)
        try:
            yield
        finally:
            self._elements = ()
            self._grids.clear()

    def before_network(self, unet: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        """Take note of the size of what goes into the network: its hook before each pass."""
        latent = args[0] if args else kwargs["sample"]
        self._latent = (int(latent.shape[2]), int(latent.shape[3]))

    def looked_at(self, layer: str, features: Tensor) -> list[Tensor | None]:
        """Return for each entry of a batch (b, tokens, channels) the warped features of its neighbours, or None.

        Keeps the features first, so that views of one batch see each other. Raises ValueError where the batch is not
        what was announced.
        """
        if not self._elements:
            return [None] * len(features)
        if len(features) != len(self._elements):
            raise ValueError(f"{len(self._elements)} views were announced, the network was given {len(features)}")
        size = self._tokens(features.shape[1])
        if size is None:
            return [None] * len(features)
        windows = [element.window.in_tokens(*size) for element in self._elements]
        for element, window, own in zip(self._elements, windows, features, strict=True):
            if element.is_source:
                self.maps.put(element.view, layer, own, window)
        return [self._sources(layer, each, window) for each, window in zip(self._elements, windows, strict=True)]

    def _sources(self, layer: str, element: Element, window: Window) -> Tensor | None:
        found: list[Tensor] = []
        for source, correspondence in element.sources:
            grid, valid = self._grid(element.view, source, correspondence, window)
            if valid.any() and (features := self.maps.warped(source, layer, grid, valid)) is not None:
                found.append(features)
        return torch.cat(found) if found else None

    def _grid(
        self, view: int, source: int, correspondence: Correspondence, window: Window
    ) -> tuple[Float32[ndarray, "h w 2"], Bool[ndarray, "h w"]]:
        key = (view, source, *window.frame)
        if key not in self._grids:
            self._grids[key] = correspondence.at(*window.frame)
        grid, valid = self._grids[key]
        rows, columns = slice(window.top, window.top + window.height), slice(window.left, window.left + window.width)
        return grid[rows, columns], valid[rows, columns]

    def _tokens(self, count: int) -> tuple[int, int] | None:
        """Rows and columns of a layer's tokens; None where views don't talk at this resolution."""
        height, width = self._latent
        px_per_token = self._elements[0].window.height / height
        while height * width > count:
            # The network halves with a stride of 2 and a border of 1: odd sides round up.
            height, width, px_per_token = -(-height // 2), -(-width // 2), 2 * px_per_token
        if height * width != count:
            raise ValueError(f"{count} tokens are no halving of a latent of {self._latent[0]} x {self._latent[1]}")
        return (height, width) if round(px_per_token) in self.settings.px_per_token else None


@contextmanager
def exchanging(unet: Any, settings: MutualAttention) -> Generator[Exchange]:
    """Let the self-attention (attn1) of a diffusers UNet look at other views, and put its own processors back after.

    Raises ValueError where no layer has one of the names.
    """
    exchange = Exchange(settings)
    before = dict(unet.attn_processors)
    layers = {name: name.removesuffix(".processor") for name in before}
    chosen = {
        name: MutualSelfAttention(layer, exchange, settings.most_scores)
        for name, layer in layers.items()
        if layer.endswith("attn1") and any(fnmatchcase(layer, pattern) for pattern in settings.layers)
    }
    if not chosen:
        raise ValueError(f"no self-attention layer is named like {', '.join(settings.layers)}")
    unet.set_attn_processor({**before, **chosen})
    hook = unet.register_forward_pre_hook(exchange.before_network, with_kwargs=True)
    try:
        yield exchange
    finally:
        hook.remove()
        unet.set_attn_processor(before)
