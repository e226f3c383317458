"""Other colours for splats: what they are rather than how they look."""

from collections.abc import Sequence
from dataclasses import replace
from typing import no_type_check

import numba
import numpy as np

from gsrain_engine.render.heat_colors import heat_colors, layer_color
from gsrain_engine.render.look import Look
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.members import Part

from .splats import Splats
from .tint import TINT, TINT_SHARE


def in_colors_of(look: Look, splats: Splats, parts: Sequence[Part], camera: Camera) -> Splats:
    """Colour the splats of `parts` by their normals, opacity or layer; any other look leaves them as they are.

    What is selected is tinted here, too.
    """
    if look not in ("normals", "opacity", "layers"):
        return splats
    colors = splats.colors.copy()
    drawn = np.flatnonzero(colors[:, 3])
    ends = np.cumsum([0, *(len(part.gaussians) for part in parts)])
    bounds = np.searchsorted(splats.indices[drawn], ends)
    for number, part in enumerate(parts):
        g, rows = part.gaussians, drawn[bounds[number] : bounds[number + 1]]
        members = splats.indices[rows] - ends[number]
        if look == "normals":
            to_world = np.ascontiguousarray(part.to_world, np.float64)
            _normal_colors(rows, members, g.means, g.scales, g.quaternions, to_world, camera.position, colors)
        elif look == "opacity":
            colors[rows, :3] = heat_colors(g.opacities[members] * np.float32(part.opacity))
        else:
            colors[rows, :3] = layer_color(number)
        if part.selected is not None:
            tinted = rows[part.selected.flags[members]]
            colors[tinted, :3] += np.float32(TINT_SHARE) * (np.array(TINT, np.float32) - colors[tinted, :3])
    return replace(splats, colors=colors)


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _normal_colors(rows, members, means, scales, quaternions, to_world, eye, colors):
    """0.5 + 0.5 n of each Gaussian's shortest axis n in the world, turned to the eye; `rows` are those in `colors`."""
    for n in numba.prange(len(rows)):
        i = members[n]
        w, x, y, z = quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3]
        w, x, y, z = np.float64(w), np.float64(x), np.float64(y), np.float64(z)
        if scales[i, 0] <= scales[i, 1] and scales[i, 0] <= scales[i, 2]:
            a, b, c = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
        elif scales[i, 1] <= scales[i, 2]:
            a, b, c = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)
        else:
            a, b, c = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
        length = facing = 0.0
        for k in range(3):
            normal = to_world[k, 0] * a + to_world[k, 1] * b + to_world[k, 2] * c
            mean = to_world[k, 0] * means[i, 0] + to_world[k, 1] * means[i, 1] + to_world[k, 2] * means[i, 2]
            facing += normal * (mean + to_world[k, 3] - eye[k])
            length += normal * normal
        half = (-0.5 if facing > 0 else 0.5) / max(np.sqrt(length), 1e-300)
        for k in range(3):
            normal = to_world[k, 0] * a + to_world[k, 1] * b + to_world[k, 2] * c
            colors[rows[n], k] = 0.5 + half * normal
