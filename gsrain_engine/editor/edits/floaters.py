"""Floaters: finds Gaussians that hang in the air of a capture, by opacity, size and isolation."""

from collections.abc import Generator, Iterator
from dataclasses import replace
from typing import Annotated

import numpy as np
import scipy
from jaxtyping import Bool, Float32, Float64
from msgspec import Meta

from ...scene.flags import BitMask
from ...scene.gaussians import Gaussians
from ...scene.progress import Progress
from ...scene.scene import Actor, Layer, Scene, core_bounds
from ...settings import Settings
from .members import edit_members, is_editable

_BATCH_SIZE = 20_000  # number of Gaussians in a neighbor query between two chances to cancel


class FloaterRules(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Criteria for floaters; a Gaussian that meets any enabled one is a floater."""

    opacity_below: Annotated[
        float, Meta(ge=0, le=1, title="Opacity below", description="Fainter ones are floaters; 0 turns the rule off.")
    ] = 0.05
    size_above_m: Annotated[
        float,
        Meta(
            ge=0, le=1000, title="Size above",
            description="Larger ones (longest standard deviation) are floaters; 0 turns the rule off.",
            extra={"unit": "m"},
        ),
    ] = 0.0  # fmt: skip
    isolation_above: Annotated[
        float,
        Meta(
            ge=0, le=1000, title="Isolation above", extra={"unit": "x median"},
            description="Those farther from their neighbors than so many times the median are floaters; 0 turns the "
            "rule off.",
        ),
    ] = 8.0  # fmt: skip
    neighbors: Annotated[
        int,
        Meta(ge=1, le=64, title="Neighbors", description="Number of nearest Gaussians that isolation is measured to."),
    ] = 8


def search_floaters(
    scene: Scene, rules: FloaterRules
) -> Generator[Progress, None, dict[str, tuple[Gaussians, BitMask]]]:
    """Search the editable background layers; return the floaters of each by its key, with its Gaussians.

    Gaussians of a far shell, such as a sky dome, are never floaters.
    """
    found = dict[str, tuple[Gaussians, BitMask]]()
    layers = [each for each in scene.layers if is_editable(each) and each.kind == "background"]
    parts = [scene.part(each) for each in scene.layers if each.visible and each.kind == "background"]
    shell = core_bounds([part for part in parts if part is not None]).shell
    total = sum(len(each.gaussians) for each in layers) or 1
    done = 0
    for layer in layers:
        part = scene.part(layer)
        assert part is not None
        count = len(part.gaussians)
        there = np.arange(count) if part.left_out is None else np.flatnonzero(~part.left_out.flags)
        flags = np.zeros(count, np.bool_)
        flags[there] = part.gaussians.opacities[there] * np.float32(part.opacity) < rules.opacity_below
        if rules.size_above_m > 0:
            scale = np.float32(float(np.cbrt(np.linalg.det(part.to_world[:3, :3]))))
            sizes_m = part.gaussians.scales[there].max(axis=1, initial=0) * scale
            flags[there] |= sizes_m > rules.size_above_m
        if rules.isolation_above > 0 and len(there) > 1:
            for share, isolated in _isolated(part.gaussians.means[there], rules):
                yield Progress((done + share * count) / total, f"Looking at the neighbors in {layer.name}")
                if isolated is not None:
                    flags[there] |= isolated
        if shell is not None:
            flags &= ~shell.holds(part)
        done += count
        found[layer.key] = part.gaussians, BitMask.of(flags)
    return found


def select_floaters(scene: Scene, found: dict[str, tuple[Gaussians, BitMask]]) -> Scene:
    """Select exactly the found floaters; layers whose Gaussians have changed since are skipped."""

    def selecting(member: Layer | Actor) -> Layer | Actor:
        gaussians, mask = found.get(member.key, (None, None))
        selected = mask if gaussians is member.gaussians and mask else None
        if selected is None and member.marks.selected is None:
            return member
        return replace(member, marks=replace(member.marks, selected=selected))

    return edit_members(scene, selecting)


def _isolated(
    means: Float32[np.ndarray, "n 3"], rules: FloaterRules
) -> Iterator[tuple[float, Bool[np.ndarray, " n"] | None]]:
    """Yield the progress, and in the last item the isolated Gaussians. Non-finite means are isolated."""
    finite = np.isfinite(means).all(axis=1)
    places = means[finite]
    distances: list[Float64[np.ndarray, " m"]] = [np.zeros(0)]
    if len(places) > 1:
        yield 0.0, None
        tree = scipy.spatial.KDTree(places, balanced_tree=False, compact_nodes=False)
        count = min(rules.neighbors, len(places) - 1)
        for start in range(0, len(places), _BATCH_SIZE):
            near, _ = tree.query(places[start : start + _BATCH_SIZE], k=count + 1, workers=-1)
            distances.append(near[:, 1:].mean(axis=1))  # the nearest is the Gaussian itself
            yield min(0.1 + 0.9 * (start + _BATCH_SIZE) / len(places), 0.99), None
    mean_distance = np.full(len(means), np.inf)
    mean_distance[finite] = np.concatenate(distances) if len(places) > 1 else 0.0
    median = float(np.median(mean_distance[finite])) if finite.any() else 0.0
    yield 1.0, mean_distance > rules.isolation_above * max(median, np.finfo(np.float64).tiny)
