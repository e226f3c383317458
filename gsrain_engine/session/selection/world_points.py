"""Centres of Gaussians of several members in one array, and the way back to masks."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int64

from gsrain_engine.scene.mask import Mask

from .candidates import Candidate, Found


def world_points(
    members: Sequence[Candidate], among: Found
) -> tuple[Float64[np.ndarray, "m 3"], Int64[np.ndarray, "m 2"]]:
    """Centres in the world (metres) of Gaussians, and whose they are: place of the member in the list, own index.

    In the order of members, then of indices.
    """
    points, owners = [np.zeros((0, 3))], [np.zeros((0, 2), np.int64)]
    for number, each in enumerate(members):
        mask = among.get(each.key)
        if mask:
            indices = mask.indices
            to_world = each.part.to_world
            points.append(each.part.gaussians.means[indices] @ to_world[:3, :3].T + to_world[:3, 3])
            owners.append(np.stack([np.full(len(indices), number), indices], axis=1))
    return np.concatenate(points), np.concatenate(owners)


def by_member(members: Sequence[Candidate], owners: Int64[np.ndarray, "m 2"]) -> dict[str, Mask]:
    """Masks of Gaussians that are told by their owners, see `world_points`."""
    found: dict[str, Mask] = {}
    for number, each in enumerate(members):
        flags = np.zeros(len(each.part.gaussians), np.bool_)
        flags[owners[owners[:, 0] == number, 1]] = True
        found[each.key] = Mask.of(flags)
    return found
