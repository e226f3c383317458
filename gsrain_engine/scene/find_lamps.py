"""Lamps of a scene by night, found as small bright clusters of Gaussians, with their light measured around them."""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float64, Int64
from msgspec import structs

from .flags import BitMask
from .gaussians import SH_C0, Gaussians, scene_cache
from .geometry import LUMINANCE, matrices_from_quaternions, srgb_to_linear
from .lamps import MAX_LAMPS, Lamp, Vector
from .objects import is_vehicle
from .scene import Actor, Layer, Scene, is_sky
from .vehicle_lamps import VehicleLamps

# Nights

DARK_MEDIAN, DARK_HIGH = 0.05, 0.25
"""Luminances (display white is 1) below which the median and 90 % of a scene's Gaussians are by night.

The street has 0.007 and 0.08 by night, 0.10 and 0.25 under clouds, 0.16 and 0.61 in the sun.
"""

# Clusters

BRIGHT = 0.8
"""Smallest value of a lamp's brightest channel; one over white in the display is clipped there."""
_GLOW = BRIGHT / 3
"""Gaussians of this brightness around bright ones are of the same surface, and count to its extent."""
_GAP_M = 0.25  # between Gaussians of a lamp
_LARGEST_M = 0.9  # extent of a lamp: larger clusters are windows, signs and lit walls
_SMALLEST_M2 = 2e-4  # projected area
_OPAQUE = 0.3
_WHITE = 0.95  # clipped
_LIT_M = 3.0
_FAINT = 0.02  # less opaque Gaussians are no surfaces
_MAX_CLUSTERS = 256

# Light on surfaces around

ALBEDO = 0.12
"""Albedo of what lamps light: asphalt has 0.1, walls have 0.3."""
_AROUND_M = 0.4, 12.0
_SAMPLES = 12_000  # surfaces that the fit takes
_FEWEST = 40  # surfaces below a lamp from which its light is measured
_FLAT_COSINE = 0.15
_BELOW, _ASIDE = 0.5, -0.3
"""Cosines from the direction down: a lantern's cone, and what is above it. Light between them is fitted apart."""
_ROUNDS, _EXACT = 6, 0.1  # of the fit; relative deviations below count alike
_RINGS = 32  # of directions from a lamp, for shadows
_CELL_STRIDE = 1e4
_BEFORE_M = 0.35  # surfaces closer than this before a point are its own, and do not shade it
_UPWARD = 1.0  # share of the light down from which a lamp has no cone: leaves around a lantern return much
CLIPPED = 300.0
"""Radiance of a clipped lamp of unknown light: a tail light of the street by night has 100, a lantern 4000."""
_FAINTEST = 1e-3  # of the brightest lamp


class _Part(NamedTuple):
    """A visible member that is no sky, in its frame: a layer in the scene's, an actor in its own."""

    gaussians: Gaussians
    left_out: BitMask | None
    opacity: float
    mount: str
    """Id of the actor; `scene` for a layer."""
    is_vehicle: bool
    to_frame: tuple[float, ...]
    """Similarity to the frame, by rows."""


class _Surfaces(NamedTuple):
    """Gaussians of one frame, scaled to meters."""

    means_m: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"]
    """Directions of the smallest axes."""
    widths_m: Float64[np.ndarray, " n"]
    """Geometric mean of the larger two standard deviations."""
    opacities: Float64[np.ndarray, " n"]
    light: Float64[np.ndarray, "n 3"]
    """Linear light, averaged over all directions."""

    @property
    def areas_m2(self) -> Float64[np.ndarray, " n"]:
        return 2 * np.pi * self.opacities * self.widths_m**2

    def take(self, rows: Int64[np.ndarray, " m"] | Bool[np.ndarray, " n"]) -> "_Surfaces":
        return _Surfaces(*(each[rows] for each in self))


def find_lamps(scene: Scene) -> tuple[Lamp, ...]:
    """Find the lamps of a scene that was captured by night; none by day.

    A lamp is a cluster of bright, opaque Gaussians of at most 0.9 m; those of actors are mounted on them. Its intensity
    is its radiance times its projected area (a wall of radiance 1 is display white), and at least what explains the
    light of surfaces around it: a flat Gaussian of the albedo rho returns the sum of rho I cos / (pi d^2) over the
    lamps, a least-squares problem for their intensities, downward and upward. A display clips radiance at white:
    without surfaces around, a clipped lamp counts as 300 times as bright, and those of vehicles as in `VehicleLamps`.
    """
    parts = tuple(_part(each) for each in scene.members if each.visible and not is_sky(each))
    return _found(parts, scene.metres_per_unit, scene.up)


def is_dark(scene: Scene) -> bool:
    """Return whether a scene shows a night, by the light of its visible Gaussians that are no sky."""
    parts = [_part(each) for each in scene.members if each.visible and not is_sky(each)]
    return _are_dark([_surfaces(part, scene.metres_per_unit) for part in parts])


def _are_dark(surfaces: list["_Surfaces"]) -> bool:
    light = np.concatenate([np.zeros(0), *(each.light @ LUMINANCE for each in surfaces)])
    if not len(light):
        return False
    weights = np.concatenate([each.opacities for each in surfaces])
    middle, high = _quantiles(light, weights, (0.5, 0.9))
    return middle <= DARK_MEDIAN and high <= DARK_HIGH


def _part(member: Layer | Actor) -> _Part:
    pose = member.to_scene if isinstance(member, Layer) else np.eye(4)
    mount = member.id if isinstance(member, Actor) else "scene"
    drives = isinstance(member, Actor) and is_vehicle(member.class_name)
    return _Part(member.gaussians, member.marks.left_out, member.opacity, mount, drives, tuple(pose.ravel().tolist()))


@scene_cache(4)
def _found(parts: tuple[_Part, ...], metres_per_unit: float, up: Vector) -> tuple[Lamp, ...]:
    """Lamps of all parts; cached, as drives have the same parts in every frame."""
    surfaces = [_surfaces(part, metres_per_unit) for part in parts]
    if not _are_dark(surfaces):
        return ()
    lamps: list[Lamp] = []
    for mount in dict.fromkeys(part.mount for part in parts):
        own = [k for k, part in enumerate(parts) if part.mount == mount]
        joined = _Surfaces(*(np.concatenate(columns) for columns in zip(*(surfaces[k] for k in own), strict=True)))
        sources = _no_reflections([_source(joined.take(rows)) for rows in _clusters(joined)])
        if mount == "scene":
            x, y, z = up
            down = -np.array((x, y, z)) / np.linalg.norm(up)
            lamps += _measured(sources, joined, down, metres_per_unit)
        else:
            lamps += [_mounted(each, parts[own[0]], metres_per_unit) for each in sources]
    least = _FAINTEST * max((lamp.intensity_m2 for lamp in lamps), default=0.0)
    order = sorted(range(len(lamps)), key=lambda k: -lamps[k].intensity_m2)[:MAX_LAMPS]
    kept = [lamps[k] for k in sorted(order) if lamps[k].intensity_m2 > least]
    return tuple(structs.replace(lamp, name=f"found {number}") for number, lamp in enumerate(kept, 1))


def _surfaces(part: _Part, metres_per_unit: float) -> _Surfaces:
    g, to_frame = part.gaussians, np.array(part.to_frame).reshape(4, 4)
    rows = np.flatnonzero(g.opacities > _FAINT) if part.left_out is None else np.flatnonzero(~part.left_out.flags)
    means, scales, opacities = (each[rows].astype(np.float64) for each in (g.means, g.scales, g.opacities))
    order = np.sort(scales, axis=1) * metres_per_unit * float(np.cbrt(np.linalg.det(to_frame[:3, :3])))
    turns = matrices_from_quaternions(g.quaternions[rows].astype(np.float64))
    normals = np.take_along_axis(turns, np.argmin(scales, axis=1)[:, None, None], axis=2)[:, :, 0]
    display = np.clip(g.sh[rows, 0].astype(np.float64) * SH_C0 + 0.5, 0, 1)
    good = np.isfinite(means).all(axis=1) & np.isfinite(order).all(axis=1) & np.isfinite(display).all(axis=1)
    return _Surfaces(
        metres_per_unit * (means @ to_frame[:3, :3].T + to_frame[:3, 3]),
        normals @ (to_frame[:3, :3].T / np.cbrt(np.linalg.det(to_frame[:3, :3]))),
        np.sqrt(order[:, 1] * order[:, 2]),
        part.opacity * opacities,
        srgb_to_linear(display),
    ).take(np.flatnonzero(good))


def _quantiles(
    values: Float64[np.ndarray, " n"], weights: Float64[np.ndarray, " n"], shares: tuple[float, ...]
) -> list[float]:
    order = np.argsort(values)
    summed = np.cumsum(weights[order])
    rows = np.searchsorted(summed, np.array(shares) * summed[-1])
    return [float(values[order[min(row, len(order) - 1)]]) for row in rows]


def _clusters(surfaces: _Surfaces) -> list[Int64[np.ndarray, " m"]]:
    """Rows of the bright Gaussians of each lamp, which touch, with those that glow around them, in a small extent."""
    brightness, areas_m2 = surfaces.light.max(axis=1), surfaces.areas_m2
    glowing = np.flatnonzero((brightness >= _GLOW) & (surfaces.opacities >= _OPAQUE))
    glowing = glowing[surfaces.widths_m[glowing] < _LARGEST_M / 2]
    if not len(glowing):
        return []
    places = surfaces.means_m[glowing]
    pairs = scipy.spatial.cKDTree(places).query_pairs(_GAP_M, output_type="ndarray")
    graph = scipy.sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(glowing),) * 2)
    count, labels = scipy.sparse.csgraph.connected_components(graph, directed=False)
    order = np.argsort(labels, kind="stable")
    found: list[Int64[np.ndarray, " m"]] = []
    for rows in np.split(glowing[order], np.searchsorted(labels[order], np.arange(1, count))):
        extent = np.ptp(surfaces.means_m[rows], axis=0) + 2 * float(surfaces.widths_m[rows].max())
        bright = rows[brightness[rows] >= BRIGHT]
        if np.linalg.norm(extent) <= _LARGEST_M and areas_m2[bright].sum() >= _SMALLEST_M2:
            found.append(bright)
    strength = [-float(areas_m2[rows] @ brightness[rows]) for rows in found]
    return [found[k] for k in np.argsort(strength, kind="stable")[:_MAX_CLUSTERS]]


class _Source(NamedTuple):
    """A cluster as a source of light."""

    place_m: Float64[np.ndarray, "3"]
    light_m2: Float64[np.ndarray, "3"]
    """Recorded radiance times projected area, which is at most that of the outline."""
    radiance: Float64[np.ndarray, "3"]
    """Recorded; clipped at 1."""


def _source(cluster: _Surfaces) -> _Source:
    weights = cluster.areas_m2
    place = weights @ cluster.means_m / weights.sum()
    spread = (cluster.means_m - place).T * weights @ (cluster.means_m - place) / weights.sum()
    own = weights @ cluster.widths_m**2 / weights.sum()
    first, second = np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[1:], 0) + own)
    radiance = weights @ cluster.light / weights.sum()
    return _Source(place, min(weights.sum(), 4 * np.pi * first * second) * radiance, radiance)


def _no_reflections(sources: list[_Source]) -> list[_Source]:
    """Leave out clusters close to a more radiant one, which can be what that lights: leaves around a lantern."""
    places = np.array([source.place_m for source in sources]).reshape(-1, 3)
    luminances = np.array([source.radiance @ LUMINANCE for source in sources])
    lit: set[int] = set()
    for one, other in scipy.spatial.cKDTree(places).query_pairs(_LIT_M) if sources else ():
        darker, brighter = sorted((one, other), key=lambda k: luminances[k])
        if luminances[darker] < 0.97 * luminances[brighter]:
            lit.add(darker)
    return [source for k, source in enumerate(sources) if k not in lit]


def _measured(
    sources: list[_Source], surfaces: _Surfaces, down: Float64[np.ndarray, "3"], metres_per_unit: float
) -> list[Lamp]:
    """Lamps of layers: clusters with the light that surfaces around them return."""
    if not sources:
        return []
    thrown, upward, below = _thrown(sources, surfaces, down)
    lamps: list[Lamp] = []
    for k, source in enumerate(sources):
        light, angles = source.light_m2, (50.0, 85.0)
        if below[k] >= _FEWEST:
            if thrown[k] @ LUMINANCE > light @ LUMINANCE:
                light = thrown[k]
            if upward[k] > _UPWARD:
                angles = 180.0, 180.0
        elif source.radiance.max() > _WHITE:
            light = CLIPPED * light
        x, y, z = (source.place_m / metres_per_unit).tolist()
        a, b, c = down.tolist()
        red, green, blue = (light / light.max()).tolist()
        lamps.append(
            Lamp(
                position=(x, y, z), direction=(a, b, c), color=(red, green, blue), intensity_m2=float(light.max()),
                inner_deg=angles[0], outer_deg=angles[1],
            )
        )  # fmt: skip
    return lamps


def _thrown(
    sources: list[_Source], surfaces: _Surfaces, down: Float64[np.ndarray, "3"]
) -> tuple[Float64[np.ndarray, "k 3"], Float64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Intensities (m2) that explain the light of surfaces, those upward over those downward, and surfaces below each.

    The luminance of surfaces is fitted, scaled by the squared distance of the nearest source, so that near and far ones
    count alike. The hue is that of the surfaces below, in proportion to what a source adds to them.
    """
    places = np.array([source.place_m for source in sources])
    nearest, _ = scipy.spatial.cKDTree(places).query(surfaces.means_m, distance_upper_bound=_AROUND_M[1])
    rows = np.flatnonzero((nearest > _AROUND_M[0]) & (nearest < _AROUND_M[1]) & (surfaces.light.max(axis=1) < BRIGHT))
    if len(rows) > _SAMPLES:  # even in area: objects have many small Gaussians, the ground few large ones
        summed = np.cumsum(surfaces.areas_m2[rows])
        rows = rows[np.searchsorted(summed, summed[-1] * (np.arange(_SAMPLES) + 0.5) / _SAMPLES)]
    lit, scale = surfaces.take(rows), nearest[rows] ** 2
    tree = scipy.spatial.cKDTree(surfaces.means_m)
    columns: list[Float64[np.ndarray, " n"]] = []
    below = np.zeros(len(sources), np.int64)
    for k, place in enumerate(places):
        away = lit.means_m - place
        distances = np.linalg.norm(away, axis=1)
        cosines = np.abs(np.einsum("ni,ni->n", away, lit.normals)) / distances
        around = np.array(tree.query_ball_point(place, _AROUND_M[1]), np.int64)
        returned = ALBEDO / np.pi * cosines / distances**2 * _visibility(place, surfaces.take(around), lit.means_m)
        height = away @ down / distances
        is_below = height > _BELOW
        near = (height > _ASIDE) & (cosines > _FLAT_COSINE) & (distances < _AROUND_M[1])
        below[k] = np.count_nonzero(near)
        is_aside = (height > _ASIDE) & ~is_below
        columns += [scale * returned * part for part in (is_below, is_aside, height <= _ASIDE)]
    if not len(rows):
        return np.zeros((len(sources), 3)), np.zeros(len(sources)), below
    basis = np.stack(columns, axis=1)
    fitted = _median_fit(basis, scale * (lit.light @ LUMINANCE))
    downward, upward = fitted[0::3], fitted[2::3]
    hues = (basis[:, 0::3] * downward).T @ (scale[:, None] * lit.light)
    hues /= np.maximum(hues @ LUMINANCE, 1e-30)[:, None]
    return downward[:, None] * hues, upward / np.maximum(downward, 1e-30), below


def _median_fit(basis: Float64[np.ndarray, "n k"], light: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " k"]:
    """Coefficients, none negative, with about the smallest sum of relative deviations: a median, not a mean.

    Dark cloth, white paint and shadows that `_visibility` misses count as one surface each, however far off they are
    (iteratively reweighted least squares).
    """
    weights = np.ones(len(light))
    fitted = np.zeros(basis.shape[1])
    for _ in range(_ROUNDS):
        orthogonal, triangle = np.linalg.qr(weights[:, None] * basis)
        fitted, _ = scipy.optimize.nnls(triangle, orthogonal.T @ (weights * light))
        expected = basis @ fitted
        relative = np.abs(light - expected) / np.maximum(expected, 1e-3 * max(float(expected.max(initial=0.0)), 1e-12))
        weights = 1 / np.sqrt(np.maximum(relative, _EXACT))
    return fitted


def _visibility(
    place: Float64[np.ndarray, "3"], around: _Surfaces, points: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, " n"]:
    """Share of a lamp's light at points that surfaces around it leave.

    Directions from the lamp are divided into cells of equal solid angle. In each, a surface covers its projected area:
    what is behind it is lit by exp(-covered).
    """
    away = around.means_m - place
    distances = np.linalg.norm(away, axis=1)
    near = distances > _AROUND_M[0]
    away, distances = away[near], distances[near]
    cosines = np.abs(np.einsum("ni,ni->n", away, around.normals[near])) / distances
    cover = around.areas_m2[near] * cosines / distances**2 / (4 * np.pi / (2 * _RINGS**2))
    cells, behind = _direction_cells(away), points - place
    order = np.lexsort((distances, cells))
    summed = np.concatenate([[0.0], np.cumsum(cover[order])])
    # One key for cell and distance: the cover of a cell's surfaces before a point is a difference of sums.
    keys = cells[order] * _CELL_STRIDE + distances[order]
    own = _direction_cells(behind) * _CELL_STRIDE
    first = np.searchsorted(keys, own)
    last = np.searchsorted(keys, own + np.maximum(np.linalg.norm(behind, axis=1) - _BEFORE_M, 0))
    return np.exp(-np.maximum(summed[np.maximum(last, first)] - summed[first], 0))


def _direction_cells(away: Float64[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Numbers of the cells of directions: rings of equal height, cut into twice as many parts."""
    rise = away[:, 2] / np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    ring = np.clip((0.5 + 0.5 * rise) * _RINGS, 0, _RINGS - 1).astype(np.int64)
    part = np.clip((0.5 + np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi)) * 2 * _RINGS, 0, 2 * _RINGS - 1)
    return ring * 2 * _RINGS + part.astype(np.int64)


def _mounted(source: _Source, part: _Part, metres_per_unit: float) -> Lamp:
    """Lamp of an actor: a headlight in its front half, else a tail light."""
    x, y, z = (source.place_m / metres_per_unit).tolist()
    strength, is_front = float(source.light_m2.max()), source.place_m[0] > 0
    red, green, blue = (source.light_m2 / strength).tolist()
    if part.is_vehicle:
        lamps = VehicleLamps(mount="vehicles")
        strength = lamps.headlight_m2 if is_front else lamps.tail_light_m2
    inner_deg, outer_deg = (4.0, 28.0) if is_front else (45.0, 90.0)
    return Lamp(
        mount=part.mount, position=(x, y, z), direction=(1.0, 0.0, -0.03) if is_front else (-1.0, 0.0, 0.0),
        color=(red, green, blue), intensity_m2=strength, inner_deg=inner_deg, outer_deg=outer_deg,
    )  # fmt: skip
