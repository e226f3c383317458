"""Level-of-detail (LOD) tree of merged Gaussians, and its cut for a camera: details smaller than a pixel are merged."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt32

from ..kernels import kernel, range_of
from .camera import Camera
from .gaussians import SH_C0, Gaussians, IdentityKey, scene_cache
from .lod_occlusion import CELL_PX, OcclusionMap, nothing_hidden, occlusion_map
from .mapped_arrays import release_pages

FAN_OUT = 4
"""Number of children of a node: on a surface, each level has cells twice as wide as the one below."""

MAX_ROOTS = 1024
"""Maximum number of nodes in the uppermost level, which a cut visits all."""

PIXEL = 0.75
"""Maximum error of a drawn node in pixels."""

MIN_GAUSSIANS = 1_000_000
"""Number of Gaussians in a scene from which on images are drawn with a cut by default."""

_DISPLACEMENT = 0.43  # by which children move along an axis, in standard deviations of their node
_CONTRAST = 0.1
"""Standard deviation of display colors (0..1) that increases an error to 1.4 times that of a plain surface.

Without this factor signs and markings blur first; the mean error of an image and the number of splats stay the same.
"""

_SH_C0 = float(SH_C0)  # a constant for the kernels
_BITS = 21  # bits of a cell along each axis
_MARGIN = 8.0  # extent of the cells, in boxes around the middle 98 % along each axis
_SAMPLES = 1_000_000  # maximum number of Gaussians sampled for the box, evenly in order
_REACH = 3.33  # standard deviations within which alpha is above 1/255
_MAX_SPREAD = 5.0  # maximum factor on the covariance between children; with 2.5 far walls have gaps
_MAX_SPREAD_ANTIALIASED = 1.8  # such sets have crisp outlines, which more blurs: 1.3 dB in the long street
_CORE = 0.4  # part of a node's ball that must be hidden: what its margin contributes is faint
_CORE_DILATED_PX = 0.5  # by which that part grows in the image
_DILATED_PX = 2.0  # reach of the pixel's own footprint, which renderers add to each splat
_FINEST_OCCLUDER = 2.0  # maximum error of an occluder in cells of the occlusion map
_PARTS = 16  # parts of the roots, which are walked in parallel; the result does not depend on it
_BLOCK = 64  # nodes whose places are computed at a time
_LEFT_OUT, _DIVIDED, _DRAWN = 0, 1, 2
_NEAR_M = 0.2  # nearest depth of a drawn center, as in the renderers


@dataclass(frozen=True, slots=True, eq=False)
class LodTree:
    """Merged Gaussians above those of one set, level by level; each is the parent of four, in the order of a curve.

    Node k of a level has the children 4 k to 4 k + 3 of the level below; those of the lowest level are Gaussians.
    """

    gaussians: Gaussians
    """The set that the tree belongs to: valid for this object only."""
    leaves: UInt32[np.ndarray, " n"]
    """Indices of the Gaussians along a Hilbert curve."""
    nodes: Gaussians
    """Merged Gaussians, from the lowest level to the uppermost."""
    radii: Float32[np.ndarray, " m"]
    """Radius of a ball around each node's mean that holds its Gaussians, in their units."""
    errors: Float32[np.ndarray, " m"]
    """Error of each node, in the same units; never less than that of a node below it.

    It is 0.43 times the largest standard deviation of what the node merges, about as far as its children move along an
    axis, times sqrt(1 + (c / 0.1)^2), where c is the standard deviation of the display colors in it.
    """

    def fits(self, gaussians: Gaussians) -> bool:
        """Return whether the tree belongs to a set."""
        return self.gaussians is gaussians

    @property
    def levels(self) -> Int64[np.ndarray, " l"]:
        """Start of each level in `nodes`, and the end of the last."""
        return level_starts(len(self.leaves))

    @property
    def nbytes(self) -> int:
        """Memory of the tree, without that of the Gaussians."""
        return self.leaves.nbytes + self.nodes.nbytes + self.radii.nbytes + self.errors.nbytes


def level_starts(count: int) -> Int64[np.ndarray, " l"]:
    """Start of each level of a tree of `count` Gaussians among its nodes, and the end of the last."""
    starts = [0]
    below = count
    while below > 1 and (below > MAX_ROOTS or len(starts) == 1):
        below = -(-below // FAN_OUT)
        starts.append(starts[-1] + below)
    return np.array(starts, np.int64)


def build_lod_tree(gaussians: Gaussians) -> LodTree:
    """Merge Gaussians, four by four along a Hilbert curve, then those, and so on.

    A node has the mean and covariance of its children, weighted by opacity times mean cross-section, and keeps the
    integral of their alpha over the image (moment matching as in Kerbl et al. 2024). Where that needs an opacity above
    1, the distances between the children count more, by up to a factor of 5 in covariance (1.8 for antialiased sets),
    so that a closed surface stays closed. Non-finite Gaussians have no weight. Deterministic for any number of threads.
    Memory beyond the result: 24 bytes per Gaussian.
    """
    count, k = len(gaussians), gaussians.sh.shape[1]
    leaves = _curve_order(gaussians)
    starts = level_starts(count)
    m = int(starts[-1])
    nodes = Gaussians(
        np.empty((m, 3), np.float32), np.empty((m, 3), np.float32), np.empty((m, 4), np.float32),
        np.empty(m, np.float32), np.empty((m, k, 3), np.float32),
        antialiased=gaussians.antialiased,
    )  # fmt: skip
    radii, errors, contrasts = (np.empty(m, np.float32) for _ in range(3))
    nothing = np.zeros(0, np.float32)
    for level in range(len(starts) - 1):
        own = slice(int(starts[level]), int(starts[level + 1]))
        if level == 0:
            below, order, attributes = gaussians, leaves, (nothing,) * 3
        else:
            lower = slice(int(starts[level - 1]), int(starts[level]))
            below, order = nodes.take(lower), np.zeros(0, np.uint32)
            attributes = radii[lower], errors[lower], contrasts[lower]
        above = (*nodes.take(own).arrays, radii[own], errors[own], contrasts[own])
        merging: list[np.ndarray] = [*below.arrays, order, *attributes, *above]
        _merge(_MAX_SPREAD_ANTIALIASED if gaussians.antialiased else _MAX_SPREAD, *merging)
    return LodTree(gaussians, leaves, nodes, radii, errors)


def average_below(tree: LodTree, values: Float32[np.ndarray, "n k 3"]) -> Float32[np.ndarray, "m k 3"]:
    """Average numbers of a tree's Gaussians for each node, with the weights by which it merges them."""
    merged = np.empty((len(tree.nodes), *values.shape[1:]), np.float32)
    starts, g = tree.levels, tree.gaussians
    for level in range(len(starts) - 1):
        own = slice(int(starts[level]), int(starts[level + 1]))
        if level == 0:
            _average(g.scales, g.opacities, values, tree.leaves, merged[own])
        else:
            lower = slice(int(starts[level - 1]), int(starts[level]))
            nodes, no_order = tree.nodes, np.zeros(0, np.uint32)
            _average(nodes.scales[lower], nodes.opacities[lower], merged[lower], no_order, merged[own])
    release_pages([*g.arrays, *tree.nodes.arrays, values])
    return merged


@scene_cache(maxsize=64)
def _merged_harmonics(tree: LodTree, key: IdentityKey) -> Float32[np.ndarray, "m k 3"]:
    sh: np.ndarray = key.of  # pyright: ignore[reportAssignmentType]
    return average_below(tree, sh)


def merged_harmonics(tree: LodTree, sh: Float32[np.ndarray, "n k 3"]) -> Float32[np.ndarray, "m k 3"]:
    """Harmonics of a tree's nodes for others of its Gaussians, such as wet colors; the last few are cached."""
    return _merged_harmonics(tree, IdentityKey(sh))


class CutIndices(NamedTuple):
    """Gaussians and nodes of a tree that are drawn for a camera."""

    leaves: Int64[np.ndarray, " a"]
    """Indices of the tree's Gaussians, rising by default."""
    nodes: Int64[np.ndarray, " b"]
    """Indices of its nodes."""


def cut_lod_tree(
    tree: LodTree,
    camera: Camera,
    to_world: Float64[np.ndarray, "4 4"],
    pixel: float = PIXEL,
    *,
    hidden: OcclusionMap | None = None,
    in_order: bool = True,
) -> CutIndices:
    """Find the coarsest nodes with errors under `pixel` pixels, and the Gaussians where there is none.

    Each Gaussian near the image is in the result once, itself or merged; those outside, and those behind what an
    occlusion map of the camera has as `hidden`, may be omitted. `to_world` is the similarity from the tree's Gaussians
    to the camera's world. Unless `in_order`, the Gaussians are in the order of the tree.
    """
    return _found(tree, camera, to_world, pixel, nothing_hidden() if hidden is None else hidden, in_order=in_order)


def occlusion_by_trees(trees: Iterable[tuple[LodTree, Float64[np.ndarray, "4 4"]]], camera: Camera) -> OcclusionMap:
    """Occlusion map of trees, with their similarities to the camera's world, by merged Gaussians of a few pixels."""

    def occluders(tree: LodTree, to_world: Float64[np.ndarray, "4 4"]) -> Int64[np.ndarray, " b"]:
        return _found(tree, camera, to_world, CELL_PX, nothing_hidden(), finest=_FINEST_OCCLUDER).nodes

    return occlusion_map(((tree.nodes, occluders(tree, pose), pose) for tree, pose in trees), camera)


def _found(
    tree: LodTree,
    camera: Camera,
    to_world: Float64[np.ndarray, "4 4"],
    pixel: float,
    hidden: OcclusionMap,
    *,
    finest: float = 0.0,
    in_order: bool = False,
) -> CutIndices:
    """Cut; with `finest`, of nodes only, and with those of the lowest level up to so many times the error."""
    starts = tree.levels
    m = np.ascontiguousarray(camera.world_to_camera @ to_world, np.float64)
    c = camera
    intrinsics = float(c.fx), float(c.fy), float(c.cx), float(c.cy), float(c.width), float(c.height)
    roots = int(starts[-1] - starts[-2]) if len(starts) > 1 else 0
    if roots == 0:
        return CutIndices(np.arange(len(tree.leaves)), np.zeros(0, np.int64))
    size = -(-roots // _PARTS) * FAN_OUT ** (len(starts) - 1)
    found_leaves, found_nodes = np.empty((_PARTS, size), np.uint32), np.empty((_PARTS, size // FAN_OUT + 1), np.uint32)
    counts = np.empty((_PARTS, 2), np.int64)
    scale = float(np.cbrt(abs(np.linalg.det(m[:3, :3]))))
    _cut(
        tree.leaves, tree.nodes.means, tree.radii, tree.errors, starts, m, scale, intrinsics, pixel, finest,
        float(CELL_PX), *hidden, found_leaves, found_nodes, counts,
    )  # fmt: skip
    ends = np.cumsum(counts, axis=0)
    leaves, nodes = np.empty(int(ends[-1, 0]), np.uint32), np.empty(int(ends[-1, 1]), np.int64)
    _gather(found_leaves, found_nodes, counts, ends, leaves, nodes)
    if in_order:
        leaves.sort()  # renderers draw equal depths in the order of the indices
    return CutIndices(leaves.astype(np.int64), nodes)


# Order along the curve


def _curve_order(gaussians: Gaussians) -> UInt32[np.ndarray, " n"]:
    if not len(gaussians):
        return np.zeros(0, np.uint32)
    sample = gaussians.means[:: -(-len(gaussians) // _SAMPLES)]
    sample = sample[np.isfinite(sample).all(axis=1)].astype(np.float64)
    low, high = np.quantile(sample, [0.01, 0.99], axis=0) if len(sample) else np.zeros((2, 3))
    middle, side = 0.5 * (low + high), max(float((high - low).max()), 1e-30)
    codes = np.empty(len(gaussians), np.uint64)
    _hilbert_codes(gaussians.means, middle - 0.5 * _MARGIN * side, 2.0**_BITS / (_MARGIN * side), codes)
    return np.argsort(codes, kind="stable").astype(np.uint32)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _hilbert_codes(portion, means, low, cells_a_unit, codes):
    """Write each mean's place on a Hilbert curve of 2^63 cells (transposed form of Skilling 2004)."""
    for n in range_of(portion, len(codes)):
        x = np.empty(3, np.uint64)
        for axis in range(3):
            cell = (means[n, axis] - low[axis]) * cells_a_unit
            if not (cell > 0):  # also NaN
                cell = 0.0
            x[axis] = np.uint64(min(2.0**_BITS - 1, cell))
        bit = np.uint64(1 << (_BITS - 1))
        while bit > np.uint64(1):
            below = bit - np.uint64(1)
            for axis in range(3):
                if x[axis] & bit:
                    x[0] ^= below
                else:
                    change = (x[0] ^ x[axis]) & below
                    x[0] ^= change
                    x[axis] ^= change
            bit >>= np.uint64(1)
        x[1] ^= x[0]
        x[2] ^= x[1]
        change = np.uint64(0)
        bit = np.uint64(1 << (_BITS - 1))
        while bit > np.uint64(1):
            if x[2] & bit:
                change ^= bit - np.uint64(1)
            bit >>= np.uint64(1)
        code = np.uint64(0)
        for k in range(_BITS - 1, -1, -1):
            for axis in range(3):
                code = (code << np.uint64(1)) | (((x[axis] ^ change) >> np.uint64(k)) & np.uint64(1))
        codes[n] = code


# Merging


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _merge(
    portion, max_spread, means, scales, quaternions, opacities, sh, order, radii, errors, contrasts, to_means,
    to_scales, to_quaternions, to_opacities, to_sh, to_radii, to_errors, to_contrasts,
):  # fmt: skip
    """Merge children four by four.

    `order` lists them if it is not empty; without `radii`, `errors` and `contrasts` they are Gaussians.
    """
    count = len(order) if len(order) > 0 else len(means)
    for n in range_of(portion, len(to_means)):
        first, last = n * FAN_OUT, min(count, (n + 1) * FAN_OUT)
        weights = np.zeros(FAN_OUT)
        members = np.zeros(FAN_OUT, np.int64)
        mean, total = np.zeros(3), 0.0
        for j in range(first, last):
            i = np.int64(order[j]) if len(order) > 0 else j
            members[j - first] = i
            w = _integral(scales[i], opacities[i])
            usable = 0 < w < np.inf
            for a in range(3):
                usable = usable and np.isfinite(means[i, a])
            if usable:
                weights[j - first] = w
                total += w
                for a in range(3):
                    mean[a] += w * means[i, a]
        for c in range(sh.shape[1]):
            for color in range(3):
                to_sh[n, c, color] = 0
        if total == 0:
            for a in range(3):
                to_means[n, a], to_scales[n, a] = means[members[0], a], 0
                to_quaternions[n, 1 + a] = 0
            to_quaternions[n, 0], to_opacities[n], to_radii[n], to_errors[n], to_contrasts[n] = 1, 0, 0, 0, 0
            continue
        mean /= total
        within, between = np.zeros((3, 3)), np.zeros((3, 3))
        for j in range(last - first):
            if weights[j] == 0:
                continue
            i, share = members[j], weights[j] / total
            _add_covariance(scales[i], quaternions[i], share, within)
            for a in range(3):
                for b in range(3):
                    between[a, b] += share * (means[i, a] - mean[a]) * (means[i, b] - mean[b])
            for c in range(sh.shape[1]):
                for color in range(3):
                    to_sh[n, c, color] += np.float32(share) * sh[i, c, color]
        spread = _spread(within, between, total, max_spread)
        axes = np.eye(3)
        covariance = within + between
        _diagonalize(covariance, axes)
        deviation = np.sqrt(max(covariance[0, 0], covariance[1, 1], covariance[2, 2], 0.0))
        if spread > 1:
            covariance = within + spread * between
            axes = np.eye(3)
            _diagonalize(covariance, axes)
        variances = np.array([max(covariance[a, a], 0.0) for a in range(3)])
        cross = np.sqrt(variances[0] * variances[1] + variances[1] * variances[2] + variances[2] * variances[0])
        to_opacities[n] = min(total / cross, 1.0) if cross > 0 else 1.0
        radius = error = contrast = 0.0
        for j in range(last - first):
            i = members[j]
            if weights[j] > 0:
                own = radii[i] if len(radii) > 0 else _REACH * max(scales[i, 0], scales[i, 1], scales[i, 2])
                x, y, z = means[i, 0] - mean[0], means[i, 1] - mean[1], means[i, 2] - mean[2]
                radius = max(radius, own + np.sqrt(x * x + y * y + z * z))
                square = 0.0
                if len(errors) > 0:
                    error = max(error, errors[i])
                    square = np.float64(contrasts[i]) ** 2
                for color in range(3):
                    square += (_SH_C0 * (sh[i, 0, color] - to_sh[n, 0, color])) ** 2 / 3
                contrast += weights[j] / total * square
        error = max(error, _DISPLACEMENT * deviation * np.sqrt(1 + contrast / _CONTRAST**2))
        to_radii[n], to_errors[n], to_contrasts[n] = radius, error, np.sqrt(contrast)
        for a in range(3):
            to_means[n, a], to_scales[n, a] = mean[a], np.sqrt(variances[a])
        _write_quaternion(axes, to_quaternions[n])


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _average(portion, scales, opacities, sh, order, to_sh):
    """Average the harmonics of children four by four, with the weights of `_merge`."""
    count = len(order) if len(order) > 0 else len(sh)
    for n in range_of(portion, len(to_sh)):
        total = 0.0
        for c in range(sh.shape[1]):
            for color in range(3):
                to_sh[n, c, color] = 0
        for j in range(n * FAN_OUT, min(count, (n + 1) * FAN_OUT)):
            i = np.int64(order[j]) if len(order) > 0 else j
            w = _integral(scales[i], opacities[i])
            if 0 < w < np.inf:
                total += w
                for c in range(sh.shape[1]):
                    for color in range(3):
                        to_sh[n, c, color] += np.float32(w / total) * (sh[i, c, color] - to_sh[n, c, color])


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def _integral(scale, opacity):
    """Opacity times the root mean square of the three cross-sections, up to a factor."""
    a, b, c = np.float64(scale[0]) ** 2, np.float64(scale[1]) ** 2, np.float64(scale[2]) ** 2
    return opacity * np.sqrt(a * b + b * c + c * a)


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def _add_covariance(scale, q, share, target):
    w, x, y, z = np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), np.float64(q[3])
    columns = (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
    for axis in range(3):
        variance = share * np.float64(scale[axis]) ** 2
        column = columns[axis]
        for a in range(3):
            for b in range(3):
                target[a, b] += variance * column[a] * column[b]


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def _minors(m):
    """Sum of the principal minors of order 2: the squared cross-section."""
    return (
        m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0] + m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1] + m[2, 2] * m[0, 0]
        - m[2, 0] * m[0, 2]
    )  # fmt: skip


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def _spread(within, between, integral, largest):
    """Smallest factor g, 1 to `largest`, at which within + g between covers the integral with an opacity of 1."""
    c = _minors(within) - integral * integral
    a = _minors(between)
    b = _minors(within + between) - _minors(within) - a
    if a + b + c >= 0:
        return 1.0
    if a > 1e-12 * (b + abs(c)):
        g = (-b + np.sqrt(max(b * b - 4 * a * c, 0.0))) / (2 * a)
    elif b > 0:
        g = -c / b
    else:
        g = largest
    return min(max(g, 1.0), largest)


@kernel(error_model="numpy")
@no_type_check
def _diagonalize(m, axes):
    """Rotate a symmetric matrix to its diagonal in place (Jacobi); the columns of `axes` become its eigenvectors."""
    for _ in range(8):
        off = abs(m[0, 1]) + abs(m[0, 2]) + abs(m[1, 2])
        if off <= 1e-14 * (abs(m[0, 0]) + abs(m[1, 1]) + abs(m[2, 2])):
            break
        for p, q in ((0, 1), (0, 2), (1, 2)):
            if m[p, q] == 0:
                continue
            theta = (m[q, q] - m[p, p]) / (2 * m[p, q])
            t = (1.0 if theta >= 0 else -1.0) / (abs(theta) + np.sqrt(theta * theta + 1))
            c = 1 / np.sqrt(t * t + 1)
            s = t * c
            for k in range(3):
                left, right = m[k, p], m[k, q]
                m[k, p], m[k, q] = c * left - s * right, s * left + c * right
            for k in range(3):
                left, right = m[p, k], m[q, k]
                m[p, k], m[q, k] = c * left - s * right, s * left + c * right
            for k in range(3):
                left, right = axes[k, p], axes[k, q]
                axes[k, p], axes[k, q] = c * left - s * right, s * left + c * right


@kernel(error_model="numpy")
@no_type_check
def _write_quaternion(r, q):
    """Write the unit quaternion (w, x, y, z) of a rotation (Shepperd 1978: by its largest component)."""
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    if trace >= r[0, 0] and trace >= r[1, 1] and trace >= r[2, 2]:
        w, x, y, z = 1 + trace, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    elif r[0, 0] >= r[1, 1] and r[0, 0] >= r[2, 2]:
        w, x, y, z = r[2, 1] - r[1, 2], 1 + 2 * r[0, 0] - trace, r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]
    elif r[1, 1] >= r[2, 2]:
        w, x, y, z = r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], 1 + 2 * r[1, 1] - trace, r[1, 2] + r[2, 1]
    else:
        w, x, y, z = r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1 + 2 * r[2, 2] - trace
    length = np.sqrt(w * w + x * x + y * y + z * z)
    q[0], q[1], q[2], q[3] = w / length, x / length, y / length, z / length


# Cut


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _cut(
    portion, leaves, means, radii, errors, starts, m, scale, intrinsics, pixel, finest, cell_px, depths_m, levels,
    found_leaves, found_nodes, counts,
):  # fmt: skip
    """Walk down from all roots, in parts with their own places for what they find."""
    roots, parts = starts[-1] - starts[-2], len(counts)
    size = (roots + parts - 1) // parts
    for place in range_of(portion, parts):
        # Two threads get every other part, since roots that are in view are neighbors.
        part = place % (parts // 2) * 2 + place // (parts // 2)
        counts[part, 0], counts[part, 1] = _walk(
            part * size, min(roots, (part + 1) * size), leaves, means, radii, errors, starts, m, scale, intrinsics,
            pixel, finest, cell_px, depths_m, levels, found_leaves[part], found_nodes[part],
        )  # fmt: skip


@kernel(error_model="numpy")
@no_type_check
def _walk(
    first_root, last_root, leaves, means, radii, errors, starts, m, scale, intrinsics, pixel, finest, cell_px,
    depths_m, levels, found_leaves, found_nodes,
):  # fmt: skip
    """Walk over the tree below some roots, level by level; return the numbers of Gaussians and nodes found.

    In blocks of nodes, whose tests have no branches, so that LLVM vectorizes them.
    """
    fx, fy, cx, cy, width, height = intrinsics
    # Lengths of the normals of the planes through the eye and the image's borders.
    left, right = np.sqrt(fx * fx + cx * cx), np.sqrt(fx * fx + (width - cx) ** 2)
    up, down = np.sqrt(fy * fy + cy * cy), np.sqrt(fy * fy + (height - cy) ** 2)
    focal, top = max(fx, fy), len(starts) - 2
    room = max(last_root - first_root, 0) * FAN_OUT**top + FAN_OUT
    visited, below = np.empty(room, np.uint32), np.empty(room, np.uint32)
    lines, fates = np.empty((5, _BLOCK)), np.empty(_BLOCK, np.int8)
    leaf_count, node_count, count = 0, 0, 0
    for root in range(first_root, last_root):
        visited[count] = root
        count += 1
    for level in range(top, -1, -1):
        start, below_count = starts[level], 0
        size_below = starts[level] - starts[level - 1] if level > 0 else len(leaves)
        coarsest = pixel if level > 0 else pixel * max(finest, 1.0)
        for first in range(0, count, _BLOCK):
            number = min(_BLOCK, count - first)
            for j in range(number):
                n = start + visited[first + j]
                lines[0, j], lines[1, j], lines[2, j] = means[n, 0], means[n, 1], means[n, 2]
                lines[3, j], lines[4, j] = radii[n], errors[n]
            for j in range(number):
                x, y, z = lines[0, j], lines[1, j], lines[2, j]
                px = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
                py = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
                pz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
                ball = scale * lines[3, j]
                radius = ball + _DILATED_PX * max(pz, 0.0) / focal
                is_near_image = (
                    (pz + radius > _NEAR_M)
                    & (fx * px + cx * pz >= -radius * left)
                    & ((width - cx) * pz - fx * px >= -radius * right)
                    & (fy * py + cy * pz >= -radius * up)
                    & ((height - cy) * pz - fy * py >= -radius * down)
                )
                is_fine = (pz > _NEAR_M) & (scale * lines[4, j] * focal <= coarsest * pz)
                nearest, near = pz - _CORE * ball, 1 / pz
                lines[0, j], lines[1, j] = (fx * px * near + cx) / cell_px, (fy * py * near + cy) / cell_px
                lines[2, j], lines[3, j] = nearest, (focal * _CORE * ball / nearest + _CORE_DILATED_PX) / cell_px
                fates[j] = (_DRAWN if is_fine else _DIVIDED) if is_near_image else _LEFT_OUT
            if len(levels) > 0:
                for j in range(number):
                    u, v, nearest, reach = lines[0, j], lines[1, j], lines[2, j], lines[3, j]
                    if fates[j] != _LEFT_OUT and _is_hidden(u, v, nearest, reach, depths_m, levels):
                        fates[j] = _LEFT_OUT
            for j in range(number):
                k = np.int64(visited[first + j])
                found_nodes[node_count] = start + k
                node_count += fates[j] == _DRAWN
                if level > 0:
                    for child in range(FAN_OUT):
                        below[below_count + child] = k * FAN_OUT + child
                    below_count += min(FAN_OUT, size_below - k * FAN_OUT) if fates[j] == _DIVIDED else 0
                elif fates[j] == _DIVIDED and finest == 0:
                    for child in range(k * FAN_OUT, min(size_below, (k + 1) * FAN_OUT)):
                        found_leaves[leaf_count] = leaves[child]
                        leaf_count += 1
        visited, below, count = below, visited, below_count
    return leaf_count, node_count


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def _is_hidden(u, v, nearest_m, reach, depths_m, levels):
    """Return whether all cells within a reach of a place are hidden at a depth; place and reach in cells."""
    if nearest_m <= _NEAR_M:
        return False
    level = 0
    while level < len(levels) - 1 and reach > 2:  # at most five cells wide
        level += 1
        u, v, reach = 0.5 * u, 0.5 * v, 0.5 * reach
    columns, rows, start = levels[level, 0], levels[level, 1], levels[level, 2]
    # What lies outside of the image has the depths of its border.
    left, right = min(max(0.0, u - reach), columns - 1.0), min(max(0.0, u + reach), columns - 1.0)
    top, bottom = min(max(0.0, v - reach), rows - 1.0), min(max(0.0, v + reach), rows - 1.0)
    for column in range(np.int64(left), np.int64(right) + 1):
        for row in range(np.int64(top), np.int64(bottom) + 1):
            if depths_m[start + column * rows + row] >= nearest_m:
                return False
    return True


@kernel(parallel=True)
@no_type_check
def _gather(portion, found_leaves, found_nodes, counts, ends, leaves, nodes):
    """Copy what each part has found to its place in the result."""
    for part in range_of(portion, len(counts)):
        to = ends[part, 0] - counts[part, 0]
        for j in range(counts[part, 0]):
            leaves[to + j] = found_leaves[part, j]
        to = ends[part, 1] - counts[part, 1]
        for j in range(counts[part, 1]):
            nodes[to + j] = found_nodes[part, j]
