"""Neighbouring views in pairs: each is warped onto the other, before its transfer and after it, and compared."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32

from gsrain_engine.appearance.matching.correspondence import Correspondence, correspondence, warped
from gsrain_engine.appearance.transfer import RainyView

from .warp_error import Agreement, Mask, Perceived, warp_error

FILM_SHARE = 0.05
"""Share of mirrored light from which on a pixel counts as water film."""

LEAST_PIXELS = 256
"""Pairs that share less than this say nothing."""


@dataclass(frozen=True, slots=True)
class PairAgreement:
    """How well a view agrees with a neighbour."""

    of: str
    to: str
    """The neighbour, which is warped onto the view."""
    matched_share: float
    """Share of the view's pixels that the neighbour shows too."""
    everywhere: Agreement
    outside_film: Agreement | None
    """Where neither mirrors: reflections move with the eye, and rightly differ. None where nobody knows the film."""


@dataclass(frozen=True, slots=True, eq=False)
class WarpedPair:
    """A view and a neighbour warped onto it: what is measured, and what a sheet shows."""

    of: RainyView
    to: RainyView
    found: Correspondence
    before: Float32[np.ndarray, "h w 3"]
    """The neighbour's clear picture, from here."""
    after: Float32[np.ndarray, "h w 3"]
    dry: Bool[np.ndarray, "h w"] | None
    """Matched pixels outside the water film; None where the film is not known."""


def warped_pair(of: RainyView, to: RainyView, film_share: float = FILM_SHARE) -> WarpedPair:
    """Warp a neighbour onto a view; pixels of which more than `film_share` is mirrored, here or there, are wet."""
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
    perceived: Perceived | None = None,
) -> Iterator[PairAgreement]:
    """Compare pairs of views (of, to), one by one; those that share next to nothing are passed by.

    Args:
        views: May be lazy; a view is asked for once for each pair that it is in.
        pairs: Indices.
        has_clear: Whether the clear pictures are known; else there is no before.
        film_share: From which on a pixel counts as water film.
        perceived: A second distance, such as LPIPS.
    """
    for i, j in pairs:
        pair = warped_pair(views[i], views[j], film_share)
        mask = pair.found.valid
        if np.count_nonzero(mask) >= LEAST_PIXELS:
            dry = pair.dry
            is_dry = dry is not None and np.count_nonzero(dry) >= LEAST_PIXELS
            yield PairAgreement(
                pair.of.clear.name,
                pair.to.clear.name,
                float(mask.mean()),
                _agreement(pair, mask, has_clear, perceived),
                _agreement(pair, dry, has_clear, perceived) if dry is not None and is_dry else None,
            )


def _agreement(pair: WarpedPair, mask: Mask, has_clear: bool, perceived: Perceived | None) -> Agreement:
    after = warp_error(pair.of.image, pair.after, mask, perceived)
    before = warp_error(pair.of.clear.image, pair.before, mask, perceived) if has_clear else None
    return Agreement(int(np.count_nonzero(mask)), after, before)
