"""Opens the pictures of a training: sources to pictures of two looks, split into training and test."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from gsrain_engine.datasets.capture import CaptureError, View
from gsrain_engine.datasets.image_folder import NO_POSES
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.readable_pictures import readable_pictures

from .picture import Picture, UnpairedPictures
from .settings import PictureSettings, PictureSource
from .weather import is_daylight, weather_of

_Guide = Callable[[View], Float32[np.ndarray, "_ _"] | None]


@dataclass(frozen=True, slots=True, eq=False)
class PictureSplit:
    """What a training learns from, and what it never sees."""

    train: UnpairedPictures
    test: UnpairedPictures
    table: tuple[tuple[str, str, int, int], ...]
    """A row a source: its path, clear or rainy, pictures in all, and how many of them are for testing."""
    problems: tuple[str, ...] = ()

    def counted(self) -> Iterator[str]:
        """Say in lines what there is."""
        for path, look, count, tested in self.table:
            yield f"{path}: {count} {look} pictures, {tested} of them for testing"


def open_pictures(settings: PictureSettings, cache: Path | None = None) -> PictureSplit:
    """Open all sources; estimated guides are kept in the folder `cache`.

    Each source is split by itself, so that both parts are made up alike. Broken pictures are left out and named.
    Raises `CaptureError` where a source can't be read, has no picture of the weather asked for, or too few.
    """
    guide = _guides(settings, cache)
    rows: list[tuple[str, str, int, int]] = []
    problems: list[str] = []
    parts: dict[str, tuple[list[Picture], list[Picture]]] = {}
    for look, sources in (("clear", settings.clear), ("rainy", settings.rainy)):
        train, test = parts.setdefault(look, ([], []))
        for number, source in enumerate(sources):
            views = _chosen(source, problems)
            tested = round(settings.test_share * len(views))
            order = np.random.default_rng((settings.seed, look == "rainy", number)).permutation(len(views))
            held = set(order[:tested].tolist())
            for i, view in enumerate(views):
                name = f"{Path(source.path).name}/{view.name}"
                picture = Picture(name, view, settings.width_px, settings.height_px, settings.framing, guide)
                (test if i in held else train).append(picture)
            rows.append((source.path, look, len(views), tested))
        if not train:
            raise CaptureError(f"no {look} picture is left to train on: lower test_share {settings.test_share:g}")
    train = UnpairedPictures(tuple(parts["clear"][0]), tuple(parts["rainy"][0]))
    test = UnpairedPictures(tuple(parts["clear"][1]), tuple(parts["rainy"][1]))
    return PictureSplit(train, test, tuple(rows), tuple(problems))


def _guides(settings: PictureSettings, cache: Path | None) -> _Guide | None:
    if settings.guide == "none":
        return None
    from .guides import Guides

    if settings.normals == "none":
        return Guides(settings.guide)
    from gsrain_engine.appearance.normals.estimators import open_estimator  # loads torch

    weights = None if settings.normals_weights is None else Path(settings.normals_weights)
    checkout = None if settings.normals_checkout is None else Path(settings.normals_checkout)
    estimator = open_estimator(settings.normals, weights=weights, checkout=checkout)
    return Guides(settings.guide, estimator, settings.normals, cache)


def _chosen(source: PictureSource, problems: list[str]) -> list[View]:
    capture = open_capture(source.path)
    if source.weather != "any" and not any(weather_of(view.attributes) for view in capture):
        raise CaptureError(
            f"{source.path}: nothing says what the weather is; put clear and rainy pictures into folders of their own, "
            "with weather: any"
        )
    views = [
        view
        for view in capture
        if source.weather in ("any", weather_of(view.attributes))
        and (is_daylight(view.attributes) or not source.daytime)
    ]
    if not views:
        kind = "" if source.weather == "any" else f"{source.weather} "
        raise CaptureError(f"{source.path}: has no {kind}picture{' by day' if source.daytime else ''}")
    if source.count is not None:
        if source.count > len(views):
            raise CaptureError(f"{source.path}: count {source.count} is more than the {len(views)} pictures there are")
        views = _spread(views, source.count)
    readable = readable_pictures(replace(capture, views=tuple(views)))
    problems.extend(problem for problem in readable.problems if problem != NO_POSES)
    return list(readable.views)


def _spread(views: Sequence[View], count: int) -> list[View]:
    """Choose evenly from all sequences: neighbours in time show nearly the same picture."""
    groups: dict[str, list[View]] = {}
    for view in views:
        groups.setdefault(view.sensor, []).append(view)
    shares = dict.fromkeys(groups, 0)
    while sum(shares.values()) < count:
        open_groups = [name for name in groups if shares[name] < len(groups[name])]
        shares[min(open_groups, key=shares.__getitem__)] += 1
    chosen: list[View] = []
    for name, members in groups.items():
        places = (np.arange(shares[name]) + 0.5) * len(members) / max(shares[name], 1)
        chosen += [members[int(place)] for place in places]
    return chosen
