"""Traffic lights of a scene that was recorded by day: their lit lenses, and the lamps that these are by night."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float64, Int64

from gsrain_engine.appearance.wet_look.gaussian_surfaces import GaussianSurfaces
from gsrain_engine.appearance.wet_look.materials import lamp_share
from gsrain_engine.scene.geometry import matrices_from_quaternions, srgb_to_linear
from gsrain_engine.scene.lamps import SIGNAL_M2, Lamp
from gsrain_engine.scene.scene import Actor, Layer, Scene

_NAMES = "traffic light", "traffic signal", "signal head"
_LIT, _OPAQUE = 0.1, 0.3
_GAP_M = 0.06  # between Gaussians of a lens; lenses of a head are 9 cm apart
_LARGEST_M, _SMALLEST_M2 = 0.5, 0.003  # extent of a lens: larger ones are yellow housings; and its area
_HEAD_M = 0.6  # distance from a lens to the other parts of its head
_INNER_DEG, _OUTER_DEG = 10.0, 60.0
LENS_LIGHT = 6.0
"""Light of a lens by night, linear, relative to white."""


class SignalLens(NamedTuple):
    """A lit lens."""

    rows: Int64[np.ndarray, " m"]
    """Its Gaussians among those of its member."""
    place_m: Float64[np.ndarray, "3"]
    """Middle, in the frame of the surfaces of its member."""
    direction: Float64[np.ndarray, "3"]
    """Unit direction in which it shines, in the same frame."""
    color: Float64[np.ndarray, "3"]
    """Linear hue; its brightest channel is 1."""


def is_traffic_light(member: Layer | Actor) -> bool:
    """Return whether a layer's name, or an actor's class, is that of traffic lights."""
    name = (member.name if isinstance(member, Layer) else member.class_name).lower().replace("_", " ")
    return any(each in name for each in _NAMES)


def lit_lenses(scene: Scene, member: Layer | Actor, own: GaussianSurfaces) -> list[SignalLens]:
    """Find the lit lenses of traffic lights by day: small clusters of bright and colorful Gaussians."""
    light = srgb_to_linear(own.color.astype(np.float64))
    lit = lamp_share(light.astype(np.float32), np.zeros_like, np.zeros(len(light), np.float32))
    bright = np.flatnonzero((lit > _LIT) & (own.opacities > _OPAQUE))
    if not len(bright):
        return []
    to_world = scene.scene_to_world @ member.to_scene if isinstance(member, Layer) else np.eye(4)
    turn = to_world[:3, :3] / np.cbrt(np.linalg.det(to_world[:3, :3]))
    g, every = member.gaussians, scipy.spatial.cKDTree(np.nan_to_num(own.points))
    found: list[SignalLens] = []
    for rows in _clusters(own.points[bright].astype(np.float64)):
        rows, points = bright[rows], own.points[bright[rows]].astype(np.float64)
        area = own.area_m2[rows] * own.opacities[rows]
        if np.linalg.norm(np.ptp(points, axis=0)) > _LARGEST_M or area.sum() < _SMALLEST_M2:
            continue
        place = np.average(points, axis=0, weights=area)
        shortest = np.argmin(g.scales[rows], axis=1)
        turns = matrices_from_quaternions(g.quaternions[rows].astype(np.float64))
        axes = np.take_along_axis(turns, shortest[:, None, None], axis=2)[:, :, 0] @ turn.T
        normal = np.linalg.eigh(np.einsum("n,ni,nj->ij", area, axes, axes))[1][:, 2]
        head = np.setdiff1d(every.query_ball_point(place, _HEAD_M), bright)  # the housing is behind its lens
        if len(head):
            weights = own.area_m2[head] * own.opacities[head] + 1e-12
            normal *= -1.0 if np.average((own.points[head] - place) @ normal, weights=weights) > 0 else 1.0
        hue = np.average(light[rows], axis=0, weights=area)
        hue -= hue.min()  # the light of the sky on it
        found.append(SignalLens(rows, place, normal, hue / hue.max()))
    return found


def _clusters(points: Float64[np.ndarray, "n 3"]) -> list[Int64[np.ndarray, " m"]]:
    """Rows of points that are connected by small gaps, in the order of their first ones."""
    pairs = scipy.spatial.cKDTree(points).query_pairs(_GAP_M, output_type="ndarray")
    graph = scipy.sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    count, labels = scipy.sparse.csgraph.connected_components(graph, directed=False)
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.searchsorted(labels[order], np.arange(1, count)))


def lamps_of_lenses(scene: Scene, lenses: Iterable[tuple[Layer | Actor, list[SignalLens]]]) -> tuple[Lamp, ...]:
    """Lamps of the lit lenses of each member, mounted on the scene or on their actor."""
    found: list[Lamp] = []
    to_scene = np.linalg.inv(scene.scene_to_world)
    for member, own in lenses:
        for lens in own:
            if isinstance(member, Layer):
                place = to_scene[:3, :3] @ lens.place_m + to_scene[:3, 3]
                direction, mount = to_scene[:3, :3] @ lens.direction, "scene"
            else:
                place, direction, mount = lens.place_m / scene.metres_per_unit, lens.direction, member.id
            position, axis, color = (tuple(each.tolist()) for each in (place, direction, lens.color))
            found.append(
                Lamp(
                    name=f"traffic light {len(found) + 1}", position=position, direction=axis, color=color,
                    intensity_m2=SIGNAL_M2, inner_deg=_INNER_DEG, outer_deg=_OUTER_DEG, mount=mount,
                )
            )  # fmt: skip
    return tuple(found)
