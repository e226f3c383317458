"""Visible shares of films and standing water, drawn as colors: the rasterizers have no channels for them."""

from collections.abc import Sequence

import numpy as np

from ...scene.gaussians import SH_C0, Gaussians, IdentityKey, scene_cache
from ...scene.scene import DrawItem


def film_items(items: Sequence[DrawItem]) -> list[DrawItem]:
    """Items whose colors are their shares of films (red) and standing water (green), for renderers without channels."""
    return [
        item._replace(
            gaussians=_film_colored(item.gaussians, IdentityKey(item.film)), wet_sh=None, selected=None, colors=None
        )
        for item in items
    ]


@scene_cache(maxsize=64)
def _film_colored(gaussians: Gaussians, film: IdentityKey) -> Gaussians:
    shares: np.ndarray | None = film.of  # pyright: ignore[reportAssignmentType]
    color = np.zeros((len(gaussians), 1, 3), np.float32)
    if shares is not None:
        color[:, 0, :2] = shares
    return gaussians.with_sh((color - np.float32(0.5)) / np.float32(SH_C0))
