"""Image sets for fine-tuning: sources, weather labels, guides, and the split into training and test."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float32, Int8
from PIL import Image

from ...datasets.capture import CaptureError, CaptureFrame, readable_images
from ...datasets.capture_folder import NO_POSES
from ...datasets.open_capture import open_capture
from ...datasets.rainsense import RAIN, SEPARATE_SEQUENCES
from ...datasets.undistort import undistort_frame
from ...safe_io.files import whole_file
from ...safe_io.limits import open_file
from ..normals import NormalEstimator, normals_from_depth, normals_to_gray, open_estimator
from .settings import ImageSettings, ImageSource

_Guide = Callable[[CaptureFrame], Float32[np.ndarray, "_ _"] | None]

# Training image

Framing = Literal["stretch", "crop"]


@dataclass(frozen=True, slots=True, eq=False)
class DatasetImage:
    """One image of a data set, read on demand."""

    name: str
    view: CaptureFrame
    width: int
    height: int
    framing: Framing = "stretch"
    guide: _Guide | None = None
    """Function that computes the guide of an undistorted view; None trains without one."""

    def read(self) -> tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"] | None]:
        """Return display color 0..1, and the guide -1..1 or None. Raises `CaptureError` for a broken file."""
        view = undistort_frame(self.view)
        pixels = Image.fromarray(self._cut(view.image)).resize((self.width, self.height), Image.Resampling.LANCZOS)
        guide = None if self.guide is None else self.guide(view)
        if guide is not None:
            shrunk = cv2.resize(self._cut(guide), (self.width, self.height), interpolation=cv2.INTER_AREA)
            guide = np.clip(shrunk, -1, 1).astype(np.float32)
        return np.asarray(pixels, np.float32) / np.float32(255), guide

    def _cut(self, pixels: np.ndarray) -> np.ndarray:
        """Return the center crop with the training aspect ratio, or the whole image."""
        if self.framing == "stretch":
            return pixels
        height, width = pixels.shape[:2]
        inner_width = min(width, round(height * self.width / self.height))
        inner_height = min(height, round(width * self.height / self.width))
        left, top = (width - inner_width) // 2, (height - inner_height) // 2
        return np.ascontiguousarray(pixels[top : top + inner_height, left : left + inner_width])


@dataclass(frozen=True, slots=True, eq=False)
class UnpairedImages:
    """Images of two looks, without pairs."""

    source: tuple[DatasetImage, ...]
    target: tuple[DatasetImage, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ImageSplit:
    """Disjoint sets of images for training and test."""

    train: UnpairedImages
    test: UnpairedImages
    table: tuple[tuple[str, str, int, int], ...]
    """One row per source: its path, clear or rainy, number of images, and number of test images."""
    problems: tuple[str, ...] = ()


def identity_of(pictures: UnpairedImages) -> str:
    """Identify sets of images by their names, in a readable line that is the same on every machine."""
    names = "\n".join(Path(each.name).name for each in (*pictures.source, *pictures.target))
    digest = hashlib.sha256(names.encode()).hexdigest()[:16]
    return f"{len(pictures.source)} clear, {len(pictures.target)} rainy, {digest}"


def open_images(settings: ImageSettings, cache: Path | None = None) -> ImageSplit:
    """Open all sources; estimated guides are cached in the folder `cache`.

    Each source is split separately, so that training and test have the same mix. Broken images are skipped and listed.
    Raises `CaptureError`, which names all of them, if sources can't be read, or have too few images of their weather.
    """
    guide = None
    if settings.guide != "none":
        paths = (settings.normals_weights, settings.normals_checkout)
        estimator = None if settings.normals == "none" else open_estimator(settings.normals, *paths)
        guide = ConditioningImages(settings.guide, estimator, settings.normals, cache)
    rows: list[tuple[str, str, int, int]] = []
    problems: list[str] = []
    parts: dict[str, tuple[list[DatasetImage], list[DatasetImage]]] = {}
    chosen = _all_chosen(settings, problems)
    for look, sources in (("clear", settings.clear), ("rainy", settings.rainy)):
        train, test = parts.setdefault(look, ([], []))
        for number, source in enumerate(sources):
            views = chosen[look][number]
            tested = round(settings.test_share * len(views))
            order = np.random.default_rng((settings.seed, look == "rainy", number)).permutation(len(views))
            held = set(order[:tested].tolist())
            for i, view in enumerate(views):
                name = f"{Path(source.path).name}/{view.name}"
                picture = DatasetImage(name, view, settings.width_px, settings.height_px, settings.framing, guide)
                (test if i in held else train).append(picture)
            rows.append((source.path, look, len(views), tested))
        if not train:
            raise CaptureError(f"no {look} picture is left to train on: lower test_share {settings.test_share:g}")
    train = UnpairedImages(tuple(parts["clear"][0]), tuple(parts["rainy"][0]))
    test = UnpairedImages(tuple(parts["clear"][1]), tuple(parts["rainy"][1]))
    return ImageSplit(train, test, tuple(rows), tuple(problems))


def _all_chosen(settings: ImageSettings, problems: list[str]) -> dict[str, list[list[CaptureFrame]]]:
    """Images of each source by look. Raises `CaptureError` with the reasons of all unusable sources."""
    chosen: dict[str, list[list[CaptureFrame]]] = {"clear": [], "rainy": []}
    reasons: list[str] = []
    for look, sources in (("clear", settings.clear), ("rainy", settings.rainy)):
        for source in sources:
            try:
                chosen[look].append(_chosen(source, problems))
            except CaptureError as error:
                reasons.append(str(error))
    if reasons:
        raise CaptureError("; ".join(dict.fromkeys(reasons)))
    return chosen


def _chosen(source: ImageSource, problems: list[str]) -> list[CaptureFrame]:
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
    kind = "" if source.weather == "any" else f"{source.weather} "
    by_day = " by day" if source.daytime else ""
    if not views:
        raise CaptureError(f"{source.path}: has no {kind}picture{by_day}")
    if source.count is not None:
        if source.count > len(views):
            pictures = f"{len(views)} {kind}picture{'s' * (len(views) > 1)}{by_day}"
            raise CaptureError(f"{source.path}: count {source.count} is more than its {pictures}")
        views = _spread(views, source.count)
    readable = readable_images(replace(capture, views=tuple(views)))
    problems.extend(each for each in readable.problems if each not in (NO_POSES, SEPARATE_SEQUENCES))
    return list(readable.views)


def _spread(views: Sequence[CaptureFrame], count: int) -> list[CaptureFrame]:
    """Choose evenly from all sequences, since neighbors in time show nearly the same image."""
    groups: dict[str, list[CaptureFrame]] = {}
    for view in views:
        groups.setdefault(view.sensor, []).append(view)
    shares = dict.fromkeys(groups, 0)
    while sum(shares.values()) < count:
        open_groups = [name for name in groups if shares[name] < len(groups[name])]
        shares[min(open_groups, key=shares.__getitem__)] += 1
    chosen: list[CaptureFrame] = []
    for name, members in groups.items():
        places = (np.arange(shares[name]) + 0.5) * len(members) / max(shares[name], 1)
        chosen += [members[int(place)] for place in places]
    return chosen


# Weather and daytime labels of data sets

Weather = Literal["clear", "rainy", "other"]

_WEATHERS: Mapping[str, Weather] = {
    "clear": "clear", "partly cloudy": "clear", "overcast": "clear", "rainy": "rainy",
    "snowy": "other", "foggy": "other",
}  # fmt: skip
"""Weather labels of BDD-100K, except "undefined"."""

_DARK = ("night", "dawn/dusk")


def weather_of(attributes: Mapping[str, str]) -> Weather | None:
    """Weather by RainSense's intensity or the labels of BDD-100K; None without either."""
    if RAIN in attributes:
        return "rainy" if float(attributes[RAIN]) > 0 else "clear"
    return _WEATHERS.get(attributes.get("weather", ""))


def is_daylight(attributes: Mapping[str, str]) -> bool:
    """True unless the image is labeled as dark."""
    return attributes.get("timeofday") not in _DARK


# Guides of images: from the capture's own normals or depth, else estimated once and cached


@dataclass(frozen=True, slots=True, eq=False)
class ConditioningImages:
    """Guides by view; None for a view without known surfaces."""

    kind: Literal["up", "luma"]
    estimator: NormalEstimator | None = None
    estimator_name: str = "none"
    """Part of the cache key, so that estimators don't share files."""
    folder: Path | None = None
    """Cache folder for estimated guides; None disables the cache."""

    def __call__(self, view: CaptureFrame) -> Float32[np.ndarray, "_ _"] | None:
        """Return the guide of an undistorted view, -1..1 per pixel, or None."""
        if (normals := view.normals) is not None:
            return normals_to_gray(normals.astype(np.float32), view.camera, self.kind)
        if (depth := view.depth) is not None:
            return normals_to_gray(normals_from_depth(depth, view.camera), view.camera, self.kind)
        return None if self.estimator is None else self._estimated(view, self.estimator)

    def _estimated(self, view: CaptureFrame, estimator: NormalEstimator) -> Float32[np.ndarray, "_ _"]:
        image, camera = view.image, view.camera
        request = f"{self.estimator_name} {self.kind} {camera.fx} {camera.fy} {camera.cx} {camera.cy} {image.shape}"
        file, steps = None, None
        if self.folder is not None:
            key = hashlib.sha256(request.encode() + image.tobytes()).hexdigest()[:24]
            file = self.folder / f"{key}.npy"
            steps = _read_steps(file, image.shape[:2])
        if steps is None:
            normals = estimator.normals(image.astype(np.float32) / np.float32(255), camera)
            # Quantized to 8 bits even on first use, so that cached and new guides are equal.
            steps = np.round(normals_to_gray(normals, camera, self.kind) * 127).astype(np.int8)
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
                with whole_file(file) as temporary, temporary.open("wb") as stream:
                    np.save(stream, steps, allow_pickle=False)
        return steps.astype(np.float32) / np.float32(127)


def _read_steps(file: Path, shape: tuple[int, ...]) -> Int8[np.ndarray, "_ _"] | None:
    """Return a cached guide, quantized; None if it is missing or damaged."""
    try:
        with open_file(file) as stream:
            steps = np.load(stream, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return steps if steps.shape == shape and steps.dtype == np.int8 else None
