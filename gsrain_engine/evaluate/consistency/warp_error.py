"""How much a view differs from another one that was warped onto it: the error that is compared before and after."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import isnan, nan, sqrt

import numpy as np
from jaxtyping import Bool, Float32

Image = Float32[np.ndarray, "h w 3"]
Mask = Bool[np.ndarray, "h w"]

Perceived = Callable[[Image, Image, Mask], float]
"""A distance of two pictures of values 0..1 over a mask, such as `Lpips.distance`."""


@dataclass(frozen=True, slots=True)
class WarpError:
    """What is left when one view is laid over the other; display values of 0..1."""

    rmse: float
    contrast: float
    """Standard deviation of the picture over the same pixels: a transfer that greys everything lowers both."""
    lpips: float | None = None


@dataclass(frozen=True, slots=True)
class Agreement:
    """Two views over the pixels that are compared."""

    pixels: int
    after: WarpError
    before: WarpError | None = None

    @property
    def ratio(self) -> float:
        """Error after the transfer over that before; NaN where there is no before, or no error in it."""
        return _over(self.after.rmse, self.before.rmse) if self.before is not None else nan

    @property
    def contrast_ratio(self) -> float:
        """The same of errors in shares of each picture's contrast."""
        if self.before is None:
            return nan
        return _over(_over(self.after.rmse, self.after.contrast), _over(self.before.rmse, self.before.contrast))

    @property
    def lpips_ratio(self) -> float:
        """LPIPS after the transfer over that before; NaN where it is not known."""
        if self.before is None or self.before.lpips is None or self.after.lpips is None:
            return nan
        return _over(self.after.lpips, self.before.lpips)


def warp_error(view: Image, other: Image, mask: Mask, perceived: Perceived | None = None) -> WarpError:
    """Compare a view with another one, warped onto it, over the pixels of a mask; raises ValueError for none.

    Root mean squared difference in display values of 0..1, over all channels: 0 (the views agree) to 1, lower is
    better. The warping error of video work (Lai et al. 2018), as a root and by depth instead of flow.
    """
    if not mask.any():
        raise ValueError("the mask leaves no pixel to compare")
    shown = view[mask].astype(np.float64)
    rmse = float(np.sqrt(np.mean((other[mask] - shown) ** 2)))
    spread = float(np.sqrt(np.mean((shown - shown.mean(axis=0)) ** 2)))
    return WarpError(rmse, spread, None if perceived is None else perceived(other, view, mask))


def pooled(agreements: Iterable[Agreement]) -> Agreement | None:
    """Mean over pairs, each pixel counting alike: the root of the mean square; LPIPS is averaged. None for no pair."""
    every = list(agreements)
    if not every:
        return None
    before = [(each.pixels, each.before) for each in every if each.before is not None]
    return Agreement(
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
