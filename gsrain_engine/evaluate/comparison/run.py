"""A comparison from its settings to its table: transfers, features, distances, agreement, figure."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.evaluate.distribution.comparison import LEAST_PICTURES, SeenPictures, compared, seen
from gsrain_engine.evaluate.distribution.extractor import Extractor
from gsrain_engine.evaluate.distribution.feature_cache import FeatureCache
from gsrain_engine.scene.progress import Progress

from .agreement import PairedViews
from .figure import comparison_figure, shown_views
from .method_folders import MethodFolder, method_folder
from .settings import Comparison
from .source import ComparedSource
from .table import ComparedRow

_TRANSFERS, _FEATURES = 0.8, 0.9
"""Shares of the progress at which a part is done; learned transfers take most of the time."""


@dataclass(frozen=True, slots=True, eq=False)
class ComparisonResult:
    """What came of a comparison."""

    rows: tuple[ComparedRow, ...]
    figure: UInt8[np.ndarray, "h w 3"]
    shown: tuple[str, ...]
    """Names of the views on the figure."""
    kept: tuple[str, ...]
    """Methods whose pictures stood from an earlier run."""
    has_cameras: bool
    """Whether neighbouring views could be compared."""
    notes: tuple[str, ...] = ()
    """What the methods could not do, a sentence each."""


def run_comparison(
    comparison: Comparison,
    source: ComparedSource,
    real: Capture,
    extractor: Extractor,
    cache: FeatureCache | None,
    output: Path,
) -> Generator[Progress, None, ComparisonResult]:
    """Make what is missing, and compare. Stopped anywhere and run again, it goes on with the next method.

    Args:
        comparison: What is compared; `check_methods` has passed it.
        source: Clear views.
        real: Rainy pictures that cameras took.
        extractor: What looks at them.
        cache: Where features are kept.
        output: Folder, in which each method has one of its name.

    Raises:
        ValueError: Where a transfer or a picture fails, with the method's row; before anything else for too few views.
    """
    for name, count in ((source.name, len(source.views)), (real.name, len(real))):
        if count < LEAST_PICTURES:
            raise ValueError(f"{name}: {count} pictures; a distribution takes at least {LEAST_PICTURES}")
    output.mkdir(parents=True, exist_ok=True)
    folders: list[MethodFolder] = []
    for number, method in enumerate(comparison.methods):
        for made in method_folder(method, source, comparison, output):
            if isinstance(made, MethodFolder):
                folders.append(made)
                if number == 0 and method.method != "images":  # which may lack some views
                    shown_views(folders, comparison.shown, comparison.columns)
                continue
            share = (number + made / len(source.views)) / len(comparison.methods)
            yield Progress(_TRANSFERS * share, f"{method.name}: view {made} of {len(source.views)}")
    looked = yield from _looked(folders, real, extractor, cache)
    rows = yield from _rows(comparison, source, folders, looked, extractor)
    names = shown_views(folders, comparison.shown, comparison.columns)
    kept = tuple(each.method.name for each in folders if each.was_kept)
    figure = comparison_figure(folders, names)
    notes = tuple(f"{each.method.name}, {note}" for each in folders for note in each.notes)
    return ComparisonResult(tuple(rows), figure, tuple(names), kept, source.has_cameras, notes)


def _looked(
    folders: Sequence[MethodFolder], real: Capture, extractor: Extractor, cache: FeatureCache | None
) -> Generator[Progress, None, list[SeenPictures]]:
    """Features of the real pictures, then of each method's."""
    looked: list[SeenPictures] = []
    for number, each in enumerate([None, *folders]):
        name = "real" if each is None else each.method.name
        share = number / (len(folders) + 1)
        yield Progress(_TRANSFERS + (_FEATURES - _TRANSFERS) * share, f"{name}: features")
        looked.append(seen(name, real if each is None else open_capture(each.folder), extractor, cache))
    return looked


def _rows(
    comparison: Comparison,
    source: ComparedSource,
    folders: Sequence[MethodFolder],
    looked: Sequence[SeenPictures],
    extractor: Extractor,
) -> Generator[Progress, None, list[ComparedRow]]:
    rows: list[ComparedRow] = []
    paired: PairedViews | None = None
    if source.has_cameras:
        paired = PairedViews([each.folder for each in folders], comparison.neighbours)
    for number, (each, own) in enumerate(zip(folders, looked[1:], strict=True)):
        name = each.method.name
        yield Progress(_FEATURES + (1 - _FEATURES) * number / len(folders), f"{name}: distances")
        distance = compared(extractor, looked[0], own, resamples=comparison.resamples, seed=comparison.seed)
        yield Progress(_FEATURES + (1 - _FEATURES) * (number + 0.5) / len(folders), f"{name}: neighbouring views")
        pairs, everywhere, dry = (0, None, None) if paired is None else paired.agreement(each.folder)
        rows.append(
            ComparedRow(name=name, method=each.method.method, distance=distance, pairs=pairs, everywhere=everywhere,
                        outside_film=dry, seconds=each.seconds)
        )  # fmt: skip
    return rows
