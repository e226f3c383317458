"""Multi-view consistency: warping error between neighboring views before and after a transfer."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import isnan, nan, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from ..appearance.base import RainyView
from ..appearance.correspondence import Correspondence, correspondence, rank_neighbors, warped
from ..appearance.output_folder import is_transferred_folder, read_transferred
from ..appearance.scene_views import CachedViews
from ..choices import FILM_SHARE
from .image_metrics import Image, ImageDistance, Mask

_CACHED_VIEWS = 6
_DEFAULT_WIDTH_PX = 960


@dataclass(frozen=True, slots=True, eq=False)
class ViewFolder:
    """Views of one folder."""

    folder: Path
    views: Sequence[RainyView]
    """Each is read on access."""
    has_clear: bool
    """True if the images before their transfer are available."""
    method: str = ""
    """Transfer method, if known."""
    settings: dict[str, Any] | None = None

    @property
    def title(self) -> str:
        return f"{self.folder.name} ({self.method})" if self.method else self.folder.name

    @property
    def names(self) -> list[str]:
        return [view.clear.name for view in self.views]

    @property
    def has_poses(self) -> bool:
        """True if the camera pose of any view is known."""
        return any(self.views[i].clear.has_pose for i in range(len(self.views)))

    def chosen(self, count: int) -> list[tuple[int, int]]:
        """Pair each view with the `count` others that overlap it most."""
        clear = CachedViews(len(self.views), lambda i: self.views[i].clear)
        return [(i, j) for i, others in enumerate(rank_neighbors(clear, count)) for j in others]

    def alike(self, other: "ViewFolder", pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        """Find another folder's pairs in this one by view name; raises ValueError for a missing view."""
        if other is self:
            return list(pairs)
        mine = {name: i for i, name in enumerate(self.names)}
        theirs = {i: other.views[i].clear.name for i in {each for pair in pairs for each in pair}}
        missing = sorted(name for name in theirs.values() if name not in mine)
        if missing:
            raise ValueError(f"{self.folder}: has no view {missing[0]!r}, which {other.folder} has")
        return [(mine[theirs[i]], mine[theirs[j]]) for i, j in pairs]


def open_view_folder(folder: Path, width_px: int | None = None) -> ViewFolder:
    """Open the output of `gsrain transfer`, or a capture whose images are compared directly.

    Wider images of a capture are downscaled to `width_px` (default 960). Raises `CaptureError` if neither can be read.
    """
    if is_transferred_folder(folder):
        transferred = read_transferred(folder)
        record, views = transferred.record, _LazyViews(len(transferred), transferred.__getitem__)
        return ViewFolder(folder, views, True, record.method, dict(record.settings))
    from ..appearance.capture_views import CaptureViews
    from ..datasets.open_capture import open_capture  # loads every reader

    clear = CaptureViews(open_capture(folder), width_px or _DEFAULT_WIDTH_PX)
    return ViewFolder(folder, _LazyViews(len(clear), lambda i: RainyView(clear[i], clear[i].image)), False)


class _LazyViews(Sequence[RainyView]):
    """Views read on access; the most recent ones are cached, since each view is in several pairs."""

    def __init__(self, count: int, read: Callable[[int], RainyView]) -> None:
        self._count, self._read = count, lru_cache(maxsize=_CACHED_VIEWS)(read)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Any:
        return self._read(index)


# Warping error

MIN_PIXELS = 256  # pairs with fewer common pixels are skipped


@dataclass(frozen=True, slots=True)
class WarpError:
    """Remaining difference after warping one view onto the other; display values of 0..1."""

    rmse: float
    contrast: float
    """Standard deviation of the image over the same pixels: a transfer that grays everything lowers both."""
    lpips: float | None = None


@dataclass(frozen=True, slots=True)
class WarpAgreement:
    """Two views over the compared pixels."""

    pixels: int
    after: WarpError
    before: WarpError | None = None

    @property
    def ratio(self) -> float:
        """Error after the transfer over that before; NaN if that is unknown or 0."""
        return _over(self.after.rmse, self.before.rmse) if self.before is not None else nan

    @property
    def contrast_ratio(self) -> float:
        """The same ratio with each error divided by its image's contrast."""
        if self.before is None:
            return nan
        return _over(_over(self.after.rmse, self.after.contrast), _over(self.before.rmse, self.before.contrast))

    @property
    def lpips_ratio(self) -> float:
        """LPIPS after the transfer over that before; NaN if unknown."""
        if self.before is None or self.before.lpips is None or self.after.lpips is None:
            return nan
        return _over(self.after.lpips, self.before.lpips)


@dataclass(frozen=True, slots=True)
class PairAgreement:
    """Agreement of a view with a neighbor."""

    of: str
    to: str
    matched_share: float
    """Share of the view's pixels that are visible in the neighbor."""
    everywhere: WarpAgreement
    outside_film: WarpAgreement | None
    """Over pixels without view-dependent reflections in either view; None if the film is unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class WarpedPair:
    """A view and a neighbor warped onto it, for measurement and for the sheet."""

    of: RainyView
    to: RainyView
    found: Correspondence
    before: Image
    after: Image
    dry: Mask | None
    """Matched pixels outside the water film; None if the film is unknown."""


def warped_pair(of: RainyView, to: RainyView, film_share: float = FILM_SHARE) -> WarpedPair:
    """Warp a neighbor onto a view; pixels with more than `film_share` mirrored light in either view are wet."""
    found = correspondence(of.clear, to.clear)
    dry: Mask | None = None
    if of.film is not None and to.film is not None:
        there = warped(to.film[..., None], found)[..., 0]
        dry = found.valid & (of.film <= film_share) & (there <= film_share)
    return WarpedPair(of, to, found, warped(to.clear.image, found), warped(to.image, found), dry)


def agreements(
    views: Sequence[RainyView],
    pairs: Sequence[tuple[int, int]],
    *,
    has_clear: bool = True,
    film_share: float = FILM_SHARE,
    perceived: ImageDistance | None = None,
) -> Iterator[PairAgreement]:
    """Compare pairs of views (of, to), one by one; pairs with almost no overlap are skipped.

    `views` may be lazy: a view is read once for each of its pairs. Without `has_clear` the clear images are unknown and
    `before` is None. `film_share` is the share of mirrored light from which a pixel counts as water film, `perceived` a
    second distance, such as LPIPS.
    """
    for i, j in pairs:
        pair = warped_pair(views[i], views[j], film_share)
        everywhere = _agreement(pair, pair.found.valid, has_clear, perceived)
        if everywhere is not None:
            dry = None if pair.dry is None else _agreement(pair, pair.dry, has_clear, perceived)
            matched = float(pair.found.valid.mean())
            yield PairAgreement(pair.of.clear.name, pair.to.clear.name, matched, everywhere, dry)


def _agreement(pair: WarpedPair, mask: Mask, has_clear: bool, perceived: ImageDistance | None) -> WarpAgreement | None:
    """Compare a pair over the pixels of a mask; None for too few."""
    pixels = int(np.count_nonzero(mask))
    if pixels < MIN_PIXELS:
        return None
    after = warp_error(pair.of.image, pair.after, mask, perceived)
    before = warp_error(pair.of.clear.image, pair.before, mask, perceived) if has_clear else None
    return WarpAgreement(pixels, after, before)


def warp_error(view: Image, other: Image, mask: Mask, perceived: ImageDistance | None = None) -> WarpError:
    """Compare a view with another one, warped onto it, over the pixels of a mask; raises ValueError for an empty one.

    Root mean squared difference in display values of 0..1, over all channels: 0 (the views agree) to 1, lower is
    better. The warping error of video work (Lai et al. 2018), as a root and by depth instead of flow.
    """
    if not mask.any():
        raise ValueError("the mask leaves no pixel to compare")
    pixels = view[mask].astype(np.float64)
    rmse = float(np.sqrt(np.mean((other[mask] - pixels) ** 2)))
    spread = float(np.sqrt(np.mean((pixels - pixels.mean(axis=0)) ** 2)))
    return WarpError(rmse, spread, None if perceived is None else perceived(other, view, mask))


def pool_errors(agreements: Iterable[WarpAgreement]) -> WarpAgreement | None:
    """Pool pairs with equal weight per pixel: root mean square, and mean LPIPS; None without pairs."""
    every = list(agreements)
    if not every:
        return None
    before = [(each.pixels, each.before) for each in every if each.before is not None]
    return WarpAgreement(
        sum(each.pixels for each in every),
        _pooled([(each.pixels, each.after) for each in every]),
        _pooled(before) if len(before) == len(every) else None,
    )


def _pooled(errors: list[tuple[int, WarpError]]) -> WarpError:
    total = sum(pixels for pixels, _ in errors)
    lpips = [(pixels, each.lpips) for pixels, each in errors if each.lpips is not None]
    return WarpError(
        sqrt(sum(pixels * each.rmse**2 for pixels, each in errors) / total),
        sqrt(sum(pixels * each.contrast**2 for pixels, each in errors) / total),
        sum(pixels * value for pixels, value in lpips) / total if len(lpips) == len(errors) else None,
    )


def _over(value: float, by: float) -> float:
    return nan if isnan(by) or by <= 0 else value / by
