"""Cross-view attention (mutual self-attention, eq. 16-19): view order, feature exchange, and attention processors."""

from collections.abc import Callable, Container, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

from jaxtyping import Bool, Float32
from numpy import ndarray

from ..base import ClearView
from ..correspondence import Correspondence, rank_neighbors

torch: Any = import_module("torch")
Tensor = Any
Grid = tuple[Float32[ndarray, "_ _ 2"], Bool[ndarray, "_ _"]]


PX_PER_TOKEN = (8, 16, 32)
"""Width of the tokens of layers that attend to other views. SD-Turbo has 8 to 64; at 64 px a token covers more than an
object, so correspondences mean little."""
MAX_SCORES = 2**26
"""Attention scores in memory at once, 256 MB in float32; queries come in chunks below it."""


@dataclass(frozen=True, slots=True)
class TileWindow:
    """Rectangle of an image in pixels; the whole image if it isn't cut into tiles."""

    top: int
    left: int
    height: int
    width: int
    frame: tuple[int, int]
    """Height and width of the whole image."""

    @classmethod
    def whole(cls, height: int, width: int) -> "TileWindow":
        return cls(0, 0, height, width, (height, width))

    @property
    def is_whole(self) -> bool:
        return (self.height, self.width) == self.frame

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns of the image."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)

    def in_tokens(self, height: int, width: int) -> "TileWindow":
        """Return the window in tokens, for a map whose part for this window has `height` x `width` tokens.

        Raises ValueError if the window doesn't start at a token or tokens don't divide the image evenly.
        """
        tall = [value * height / self.height for value in (self.top, self.frame[0])]
        wide = [value * width / self.width for value in (self.left, self.frame[1])]
        if any(value != int(value) for value in (*tall, *wide)):
            raise ValueError(f"{self} does not fall on whole tokens of a map of {height} x {width}")
        return TileWindow(int(tall[0]), int(wide[0]), height, width, (int(tall[1]), int(wide[1])))


@dataclass(frozen=True, slots=True, eq=False)
class AttendingView:
    """A view on its way through the network."""

    view: int
    sources: tuple[tuple[int, Correspondence], ...] = ()
    """Earlier views that it attends to, each with the correspondence of this view's pixels."""
    is_source: bool = False
    """True if any later view attends to this one."""


class CrossViewExchange:
    """Exchange of features between views: stores them and provides each layer with those of neighbors."""

    def __init__(self, px_per_token: Container[int]) -> None:
        self.maps = FeatureMaps()
        self._px_per_token = px_per_token
        self._current: tuple[AttendingView, TileWindow] | None = None
        self._latent: tuple[int, int] = (0, 0)
        self._grids: dict[tuple[int, int, int], Grid] = {}

    @contextmanager
    def during(self, view: AttendingView, window: TileWindow) -> Generator[None]:
        """Set view and window of the next pass through the network; outside of this, attention is the plain one."""
        self._current = view, window
        try:
            yield
        finally:
            self._current = None
            self._grids.clear()

    def before_network(self, unet: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        """Record the size of the network's input; a hook before each pass."""
        latent = args[0] if args else kwargs["sample"]
        self._latent = (int(latent.shape[2]), int(latent.shape[3]))

    def neighbor_features(self, layer: str, features: Tensor) -> Tensor | None:
        """Return the warped features (n, channels) of the current view's neighbors, or None.

        `features` (1, tokens, channels) are its own, and are stored for views that attend to it.
        """
        if self._current is None:
            return None
        view, in_pixels = self._current
        size = self._tokens(features.shape[1], in_pixels)
        if size is None:
            return None
        window = in_pixels.in_tokens(*size)
        if view.is_source:
            self.maps.put(view.view, layer, features[0], window)
        found: list[Tensor] = []
        for source, correspondence in view.sources:
            key = (source, *window.frame)
            if key not in self._grids:
                self._grids[key] = correspondence.at(*window.frame)
            grid, valid = (each[window.slices] for each in self._grids[key])
            if valid.any() and (warped := self.maps.warped(source, layer, grid, valid)) is not None:
                found.append(warped)
        return torch.cat(found) if found else None

    def _tokens(self, count: int, window: TileWindow) -> tuple[int, int] | None:
        """Rows and columns of a layer's tokens; None for resolutions without cross-view attention."""
        height, width = self._latent
        px_per_token = window.height / height
        while height * width > count:
            # The network halves with stride 2 and padding 1, so odd sides round up.
            height, width, px_per_token = -(-height // 2), -(-width // 2), 2 * px_per_token
        if height * width != count:
            raise ValueError(f"{count} tokens are no halving of a latent of {self._latent[0]} x {self._latent[1]}")
        return (height, width) if round(px_per_token) in self._px_per_token else None


@contextmanager
def cross_view_attention(unet: Any, px_per_token: Container[int] = PX_PER_TOKEN) -> Generator[CrossViewExchange]:
    """Let the self-attention (attn1) of a diffusers UNet attend to other views; its own processors return on exit."""
    exchange = CrossViewExchange(px_per_token)
    before = dict(unet.attn_processors)
    layers = {name: name.removesuffix(".processor") for name in before}
    mutual = {
        name: MutualSelfAttention(layer, exchange.neighbor_features)
        for name, layer in layers.items()
        if layer.endswith("attn1")
    }
    unet.set_attn_processor({**before, **mutual})
    hook = unet.register_forward_pre_hook(exchange.before_network, with_kwargs=True)
    try:
        yield exchange
    finally:
        hook.remove()
        unet.set_attn_processor(before)


class FeatureMaps:
    """Maps (channels, height, width) over whole images, by view and layer; overlapping tiles are averaged."""

    def __init__(self) -> None:
        self._sums: dict[tuple[int, str], Tensor] = {}
        self._weights: dict[tuple[int, str], Tensor] = {}

    def put(self, view: int, layer: str, features: Tensor, window: TileWindow) -> None:
        """Store the features (tokens, channels) of a window, which is in tokens."""
        part = features.detach().T.reshape(-1, window.height, window.width)
        key = (view, layer)
        if window.is_whole:
            self._sums[key] = part
            return
        if key not in self._sums:
            self._sums[key] = part.new_zeros((part.shape[0], *window.frame))
            self._weights[key] = part.new_zeros(window.frame)
        self._sums[key][:, *window.slices] += part
        self._weights[key][window.slices] += 1

    def warped(
        self, view: int, layer: str, grid: Float32[ndarray, "h w 2"], valid: Bool[ndarray, "h w"]
    ) -> Tensor | None:
        """Return (valid tokens, channels) of a view's map, sampled on a `grid_sample` grid; None without a map."""
        features = self._sums.get((view, layer))
        if features is None:
            return None
        if (weights := self._weights.get((view, layer))) is not None:
            features = features / weights.clamp_min(1)
        places = torch.from_numpy(grid[valid])[None, None].to(features.device)
        # float32 also for half-precision networks: positions in a map need more than 11 bits.
        found = torch.nn.functional.grid_sample(
            features[None].float(), places, mode="bilinear", padding_mode="border", align_corners=False
        )
        return found[0, :, 0].T.to(features.dtype)

    def forget(self, views: set[int]) -> None:
        for maps in (self._sums, self._weights):
            for key in [key for key in maps if key[0] in views]:
                del maps[key]


# Attention plan: view order and the neighbors of each view

_SPARE = 2  # ranked neighbors beyond those needed, since not all of them come earlier in the plan


class AttentionStep(NamedTuple):
    """A view, and the earlier ones that it attends to, best first."""

    view: int
    sources: tuple[int, ...]


def attention_plan(views: Sequence[ClearView], neighbours: int) -> list[AttentionStep]:
    """Return the steps for views by their covisibility; without neighbors, each view is on its own."""
    if not neighbours or len(views) < 2:
        return [AttentionStep(view, ()) for view in range(len(views))]
    return plan_outward(rank_neighbors(views, neighbours + _SPARE), neighbours)


def plan_outward(ranked: Sequence[Sequence[int]], neighbours: int) -> list[AttentionStep]:
    """Start at the view that others rank highest, continue with the best connected one; each attends to earlier ones.

    `ranked` holds for each view its neighbors, best first. A view without a connection to earlier ones becomes a new
    anchor. Ties go to the lower index, so the plan is deterministic.
    """
    steps: list[AttentionStep] = []
    done: set[int] = set()
    for view in _outward_order(ranked):
        sources = [other for other in _connected(ranked, view) if other in done]
        steps.append(AttentionStep(view, tuple(sources[:neighbours])))
        done.add(view)
    return steps


def last_uses(steps: Sequence[AttentionStep]) -> dict[int, int]:
    """Return for each source view the last step that uses it; its features can be freed afterwards."""
    return {source: number for number, step in enumerate(steps) for source in step.sources}


def _connected(ranked: Sequence[Sequence[int]], view: int) -> list[int]:
    """Views that this one ranks, best first, then those that rank it."""
    named = list(ranked[view])
    return named + [other for other, names in enumerate(ranked) if view in names and other not in named]


def _outward_order(ranked: Sequence[Sequence[int]]) -> list[int]:
    """View order: first the one that others rank highest, then always the best connected to those before it."""
    weights = [[0.0] * len(ranked) for _ in ranked]
    for view, names in enumerate(ranked):
        for rank, other in enumerate(names):
            weights[view][other] += 1 / (1 + rank)
            weights[other][view] += 1 / (1 + rank)
    named = [sum(1 / (1 + list(names).index(view)) for names in ranked if view in names) for view in range(len(ranked))]
    reached = [0.0] * len(ranked)
    left = list(range(len(ranked)))
    order: list[int] = []
    while left:
        view = max(left, key=lambda v: (reached[v], named[v], -v))
        order.append(view)
        left.remove(view)
        for other in left:
            reached[other] += weights[view][other]
    return order


# Attention processor for diffusers' `Attention`


class MutualSelfAttention:
    """Mutual self-attention, eq. (16)-(19): queries attend to a view's own and to warped neighbors' keys and values.

    Tokens without a correspondence are left out, which is equivalent to masking with minus infinity; warped zeros would
    have weight e^0. Without neighbors it is diffusers' `AttnProcessor2_0`, for layers like those of Stable Diffusion:
    without masks, norms and residuals of their own.
    """

    def __init__(self, layer: str, neighbor_features: Callable[[str, Tensor], Tensor | None]) -> None:
        """Take the layer's name, and `CrossViewExchange.neighbor_features` as the source of other views' features."""
        self._layer, self._neighbor_features = layer, neighbor_features

    def __call__(
        self, attn: Any, hidden_states: Tensor, encoder_hidden_states: Tensor = None, attention_mask: Tensor = None
    ) -> Tensor:
        """Attend over features (1, tokens, channels); returns the same shape."""
        query, key, value = (_heads(attn, of(hidden_states)) for of in (attn.to_q, attn.to_k, attn.to_v))
        others = self._neighbor_features(self._layer, hidden_states)
        if others is not None:  # projections are linear, so they commute with warping
            key = torch.cat([_heads(attn, attn.to_k(others[None])), key], dim=2)
            value = torch.cat([_heads(attn, attn.to_v(others[None])), value], dim=2)
        found = chunked_attention(query, key, value, attn.scale).transpose(1, 2).flatten(2)
        return attn.to_out[1](attn.to_out[0](found))


def _heads(attn: Any, projected: Tensor) -> Tensor:
    """Reshape (b, tokens, heads x d) to (b, heads, tokens, d)."""
    return projected.unflatten(-1, (attn.heads, -1)).transpose(1, 2)


def chunked_attention(query: Tensor, key: Tensor, value: Tensor, scale: float, max_scores: int = MAX_SCORES) -> Tensor:
    """Return softmax(scale query key^T) value of (b, heads, tokens, d) tensors.

    The number of keys may differ from that of queries. Queries are chunked so that at most `max_scores` scores
    (b x heads x queries x keys) exist at once for any kernel of torch, unless those of one query exceed it.
    """
    scores_per_query = query.shape[0] * query.shape[1] * key.shape[2]
    chunk = max(max_scores // max(scores_per_query, 1), 1)
    parts = [
        torch.nn.functional.scaled_dot_product_attention(part, key, value, scale=scale)
        for part in query.split(chunk, dim=2)
    ]
    return parts[0] if len(parts) == 1 else torch.cat(parts, dim=2)
