"""In which order views go through the network, and whom each one looks at."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import overload

from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.appearance.matching.neighbours import neighbours

from .settings import MutualAttention

_SPARE = 2
_LONGEST_MOMENT_S = 0.1
"""A lap of nuScenes' lidar, whose beam releases the cameras."""


@dataclass(frozen=True, slots=True)
class Step:
    """Views that go through the network at once, and for each the views that it looks at, best first."""

    views: tuple[int, ...]
    sources: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """All steps. A step looks at its own views and at those of earlier steps."""

    steps: tuple[Step, ...]

    def last_use(self) -> dict[int, int]:
        """Return for each view that is looked at the last step which does so; its features can go after it."""
        return {
            source: number for number, step in enumerate(self.steps) for source in chain.from_iterable(step.sources)
        }


def separate_plan(count: int) -> Plan:
    """Return one step a view; nobody looks at anybody."""
    return Plan(tuple(Step((view,), ((),)) for view in range(count)))


def outward_plan(ranked: Sequence[Sequence[int]], neighbours: int) -> Plan:
    """Begin at the view that most others name, then take the best connected; each looks at views already done.

    `ranked` has for each view the others that see what it sees, best first. What has no connection to anything done
    gets an anchor of its own. Ties go to the lower index: the same lists give the same plan.
    """
    steps: list[Step] = []
    done: set[int] = set()
    for view in _outward_order(ranked):
        sources = tuple(other for other in _connected(ranked, view) if other in done)[:neighbours]
        steps.append(Step((view,), (sources,)))
        done.add(view)
    return Plan(tuple(steps))


def together_plan(ranked: Sequence[Sequence[int]], neighbours: int, group: int, sizes: Sequence[object]) -> Plan:
    """Cut the outward order into groups of views of one size; each looks at its own group and at earlier ones."""
    groups: list[list[int]] = []
    for view in _outward_order(ranked):
        if not groups or len(groups[-1]) == group or sizes[groups[-1][0]] != sizes[view]:
            groups.append([])
        groups[-1].append(view)
    steps: list[Step] = []
    done: set[int] = set()
    for views in groups:
        done.update(views)
        sources = (tuple(o for o in _connected(ranked, view) if o in done)[:neighbours] for view in views)
        steps.append(Step(tuple(views), tuple(sources)))
    return Plan(tuple(steps))


def planned(views: Sequence[ClearView], settings: MutualAttention | None) -> Plan:
    """Return the plan for views whose overlap is found by their depth; None or no neighbours: each for itself."""
    if settings is None or not settings.neighbours or len(views) < 2:
        return separate_plan(len(views))
    ranked = _ranked(views, settings)
    if settings.order == "outward":
        return outward_plan(ranked, settings.neighbours)
    sizes = [(view.camera.width, view.camera.height) for view in views]
    return together_plan(ranked, settings.neighbours, settings.group, sizes)


def _ranked(views: Sequence[ClearView], settings: MutualAttention) -> list[tuple[int, ...]]:
    """Neighbours of each view, best first; more than it may look at, since not all of them come before it."""
    count = settings.neighbours + _SPARE
    if settings.among == "all":
        return neighbours(views, count)
    taken = [(view.time_s, view.sensor) for view in views]
    sets = _moments(taken) if settings.among == "cameras" else _cameras(taken)
    ranked: list[tuple[int, ...]] = [()] * len(views)
    for members in sets:
        for index, others in zip(members, neighbours(_Chosen(views, members), count), strict=True):
            ranked[index] = tuple(members[other] for other in others)
    return ranked


def _cameras(taken: Sequence[tuple[float, str]]) -> list[list[int]]:
    sets: dict[str, list[int]] = {}
    for index, (_, sensor) in enumerate(taken):
        sets.setdefault(sensor, []).append(index)
    return list(sets.values())


def _moments(taken: Sequence[tuple[float, str]]) -> list[list[int]]:
    """Views of one moment each. Rigs release their cameras one after the other, but none twice in a moment."""
    sets: list[list[int]] = []
    for index in sorted(range(len(taken)), key=lambda i: (taken[i][0], i)):
        time_s, sensor = taken[index]
        start_s = taken[sets[-1][0]][0] if sets else time_s
        is_later = time_s > start_s and any(taken[other][1] == sensor for other in sets[-1])
        if not sets or is_later or time_s > start_s + _LONGEST_MOMENT_S:
            sets.append([])
        sets[-1].append(index)
    return sets


class _Chosen(Sequence[ClearView]):
    """Some of the views, still each one worked out only when it is asked for."""

    def __init__(self, views: Sequence[ClearView], indices: Sequence[int]) -> None:
        self._views, self._indices = views, indices

    @overload
    def __getitem__(self, index: int) -> ClearView: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[ClearView]: ...
    def __getitem__(self, index: int | slice) -> ClearView | Sequence[ClearView]:
        if isinstance(index, slice):
            return _Chosen(self._views, self._indices[index])
        return self._views[self._indices[index]]

    def __len__(self) -> int:
        return len(self._indices)


def _connected(ranked: Sequence[Sequence[int]], view: int) -> list[int]:
    """Views that this one names, best first, then those that name it."""
    named = list(ranked[view])
    return named + [other for other, names in enumerate(ranked) if view in names and other not in named]


def _outward_order(ranked: Sequence[Sequence[int]]) -> list[int]:
    """The view that others name first most often, then always the one that is best connected to those before it."""
    weights = [[0.0] * len(ranked) for _ in ranked]
    for view, names in enumerate(ranked):
        for rank, other in enumerate(names):
            weights[view][other] += 1 / (1 + rank)
            weights[other][view] += 1 / (1 + rank)
    named = [sum(1 / (1 + list(names).index(view)) for names in ranked if view in names) for view in range(len(ranked))]
    reached = [0.0] * len(ranked)
    left = list(range(len(ranked)))
    order: list[int] = []
    while left:
        view = max(left, key=lambda v: (reached[v], named[v], -v))
        order.append(view)
        left.remove(view)
        for other in left:
            reached[other] += weights[view][other]
    return order
