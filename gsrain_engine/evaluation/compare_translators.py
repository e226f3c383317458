"""Run of a comparison of rain translators: transfers, features, distances, view agreement and figure."""

import json
import re
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from jaxtyping import Bool, Float64, UInt8
from PIL import Image, ImageDraw, ImageFont

from ..appearance import output_folder
from ..appearance.base import ClearView, RainyView, Transfer, follow_training
from ..appearance.capture_views import CaptureViews
from ..appearance.cyclegan_turbo.weight_paths import find_transfer_weights, read_record
from ..appearance.dsine_checkout import find_dsine_checkout, find_dsine_weights
from ..appearance.finetune.dataset import DatasetImage, ImageSettings, identity_of, open_images
from ..appearance.output_folder import TransferRecord, read_transferred, write_transferred
from ..appearance.registry import TRANSFER_FILES, missing_for_transfer, open_transfer
from ..appearance.scene_views import evenly_spaced_indices
from ..appearance.wet_look.environment import ImageEnvironment, ReflectionEnvironment
from ..datasets.capture import Capture, CaptureError
from ..datasets.image_override import flat_name
from ..datasets.open_capture import capture_format, open_capture
from ..datasets.undistort import undistort_frame
from ..safe_io.errors import not_found
from ..safe_io.files import whole_file
from ..safe_io.fingerprints import input_fingerprint
from ..safe_io.limits import read_file
from ..scene.built_in import DEFAULT_SCENE
from ..scene.progress import Progress
from .compare_results import CLEAR, ComparedMethod, ComparedRow, ComparisonPairs, TransferComparison
from .fid import MIN_IMAGES, FeatureCache, ImageSetFeatures, distribution_distance, extract_features
from .fid_features import Extractor

_TRANSFERS, _FEATURES = 0.8, 0.9
"""Shares of the progress at which transfers and features are done; learned transfers take most of the time."""


@dataclass(frozen=True, slots=True, eq=False)
class ComparisonResult:
    """Results of a comparison."""

    rows: tuple[ComparedRow, ...]
    figure: UInt8[np.ndarray, "h w 3"]
    figure_views: tuple[str, ...]
    """Names of the views in the figure."""
    reused: tuple[str, ...]
    """Methods whose images were reused from an earlier run."""
    has_cameras: bool
    """True if neighboring views could be compared."""
    notes: tuple[str, ...] = ()


# Comparison inputs


@dataclass(frozen=True, slots=True, eq=False)
class ComparedSource:
    """Clear views in the world, computed on demand."""

    name: str
    views: Sequence[ClearView]
    surroundings: ReflectionEnvironment
    to_world: Float64[np.ndarray, "4 4"]
    """Similarity from the units and axes of the scene or capture to the world."""
    mask: Callable[[str], Bool[np.ndarray, "h w"] | None]
    """Mask of valid pixels by view name; None means all."""
    has_cameras: bool
    """True if the view poses are known, as comparing views with each other requires."""
    stamp: str
    """Changes with the files of the views."""


def run_comparison(
    comparison: TransferComparison,
    source: ComparedSource,
    real: Capture,
    extractor: Extractor,
    cache: FeatureCache | None,
    output: Path,
) -> Generator[Progress, None, ComparisonResult]:
    """Create missing results and compare. A stopped run resumes with the next method.

    `comparison` has no `missing_inputs`, `source` has the clear views, `real` the rainy photographs; `output` gets
    one subfolder per method. Raises ValueError if a transfer or an image fails, with the method's row; immediately for
    too few views.
    """
    for name, count in ((source.name, len(source.views)), (real.name, len(real))):
        if count < MIN_IMAGES:
            raise ValueError(f"{name}: {count} pictures; a distribution takes at least {MIN_IMAGES}")
    output.mkdir(parents=True, exist_ok=True)
    folders: list[MethodFolder] = []
    for number, method in enumerate(comparison.methods):
        for made in method_folder(method, source, comparison, output):
            if isinstance(made, MethodFolder):
                folders.append(made)
                if number == 0 and method.method != "images":  # a folder of images may lack views
                    choose_figure_views(folders, comparison.shown, comparison.columns, comparison.views.sensors)
                continue
            share = (number + made / len(source.views)) / len(comparison.methods)
            yield Progress(_TRANSFERS * share, f"{method.name}: view {made} of {len(source.views)}")
    sets: list[ImageSetFeatures] = []
    for number, each in enumerate([None, *folders]):
        name, share = "real" if each is None else each.method.name, number / (len(folders) + 1)
        yield Progress(_TRANSFERS + (_FEATURES - _TRANSFERS) * share, f"{name}: features")
        sets.append(extract_features(name, real if each is None else open_capture(each.folder), extractor, cache))
    rows: list[ComparedRow] = []
    pairs = ComparisonPairs([each.folder for each in folders], comparison.neighbours) if source.has_cameras else None
    for number, (each, own) in enumerate(zip(folders, sets[1:], strict=True)):
        name = each.method.name
        yield Progress(_FEATURES + (1 - _FEATURES) * number / len(folders), f"{name}: distances")
        distance = distribution_distance(extractor, sets[0], own, resamples=comparison.resamples, seed=comparison.seed)
        yield Progress(_FEATURES + (1 - _FEATURES) * (number + 0.5) / len(folders), f"{name}: neighboring views")
        count, everywhere, dry = (0, None, None) if pairs is None else pairs.agreement(each.folder)
        rows.append(
            ComparedRow(name=name, method=each.method.method, distance=distance, pairs=count, everywhere=everywhere,
                        outside_film=dry, seconds=each.seconds)
        )  # fmt: skip
    names = choose_figure_views(folders, comparison.shown, comparison.columns, comparison.views.sensors)
    figure = comparison_figure(folders, names)
    reused = tuple(each.method.name for each in folders if each.was_reused)
    notes = tuple(f"{each.method.name}, {note}" for each in folders for note in each.notes)
    return ComparisonResult(tuple(rows), figure, tuple(names), reused, source.has_cameras, notes)


# Method folders
# A folder of transferred images per method; an existing one with the same record is reused.


@dataclass(frozen=True, slots=True)
class MethodFolder:
    """Folder with the images of a method."""

    method: ComparedMethod
    folder: Path
    seconds: float | None
    """Duration of its transfer, including model loading; None if it was stopped before this was written."""
    was_reused: bool
    notes: tuple[str, ...] = ()
    """Limitations of its transfer, a sentence each."""


_SECONDS = "seconds.json"


class IdentityTransfer:
    """A `Transfer` that leaves views unchanged."""

    name = CLEAR

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        for view in views:
            yield RainyView(view, view.image)


def missing_inputs(comparison: TransferComparison) -> list[str]:
    """Name every file, folder and setting that a comparison lacks, with how to get it; a line each.

    Weights count as missing too if their record contradicts the settings. Loads torch only for Inception's weights.
    """
    lines: dict[str, list[str]] = {}
    for each in comparison.methods:
        for line in [] if each.method == CLEAR else missing_for_transfer(each.method, each.settings):
            lines.setdefault(_in_fields(line), []).append(repr(each.name))
    missing = [f"method{'s' * (len(names) > 1)} {', '.join(names)}: {line}" for line, names in lines.items()]
    places = [("source", comparison.source), ("capture", comparison.capture)]
    places += [("real", each) for each in comparison.real]
    if comparison.pictures is not None:
        places += [("pictures.clear", each.path) for each in comparison.pictures.clear]
        places += [("pictures.rainy", each.path) for each in comparison.pictures.rainy]
    places.append(("extractor_weights", comparison.extractor_weights))
    missing += [
        f"{field} {path}: no such file or folder"
        for field, path in places
        if path is not None and path != DEFAULT_SCENE and not Path(path).exists() and capture_format(path) is None
    ]
    if comparison.extractor == "inception" and comparison.extractor_weights is None and find_spec("torch") is not None:
        from .fid_torch_features import inception_weights_file

        missing += map(_in_fields, not_found(inception_weights_file))
    return missing


_OPTIONS = re.compile(
    r"--(method|base|weights|images|normals-weights|normals-checkout|extractor)(?![-\w])"
    r"(?: (FILE|DIR|pixels16))?(?: \(\w+\))?"
)
"""Options of other commands, which are fields of a comparison."""


def _in_fields(line: str) -> str:
    """Name the fields of a comparison in place of the options of other commands."""
    line = line.replace("by --", "by the field --")
    return _OPTIONS.sub(lambda found: found[1].replace("-", "_") + (f": {found[2]}" if found[2] else ""), line)


def record_of(method: ComparedMethod, source: ComparedSource, comparison: TransferComparison) -> TransferRecord:
    """Return the record of a method's folder: equal records give equal images."""
    settings: dict[str, Any] = msgspec.to_builtins(method.settings, enc_hook=str)
    whole = msgspec.to_builtins(comparison, enc_hook=str)
    settings |= {part: whole[part] for part in ("source", "capture", "pictures", "views")} | {"stamp": source.stamp}
    files: dict[str, Path | None] = {field: getattr(method, field) for field in TRANSFER_FILES}
    if method.method == "cyclegan-turbo":
        weights = files["weights"] = method.weights or find_transfer_weights()
        if follow_training(method.settings, read_record(weights), weights).normals == "dsine":
            files["normals_weights"] = find_dsine_weights(method.normals_weights)
            files["normals_checkout"] = find_dsine_checkout(method.normals_checkout)
    settings["files"] = {field: input_fingerprint(path) for field, path in files.items() if path is not None}
    return TransferRecord(method.method, source.name, json.loads(json.dumps(settings)), source.to_world)


def method_folder(
    method: ComparedMethod, source: ComparedSource, comparison: TransferComparison, output: Path
) -> Iterator[MethodFolder | int]:
    """Create or reuse a method's folder: yields numbers of finished views, then the folder; errors name the method."""
    folder, record = output / method.name, record_of(method, source, comparison)
    if _is_reusable(folder, record):
        try:
            seconds = float(json.loads(read_file(folder / _SECONDS))["seconds"])
        except (OSError, ValueError, KeyError, TypeError):
            seconds = None
        yield MethodFolder(method, folder, seconds, True, output_folder.read_record(folder).notes)
        return
    started = time.perf_counter()
    try:
        transfer: Transfer = IdentityTransfer()
        if method.method != CLEAR:
            transfer = open_transfer(method.method, method.settings, source.surroundings)
        for done, _ in enumerate(write_transferred(folder, transfer.transferred(source.views), record, source.mask)):
            yield done + 1
    except (ValueError, OSError) as error:
        raise ValueError(f"method {method.name!r}: {error}") from error
    seconds = round(time.perf_counter() - started, 3)
    with whole_file(folder / _SECONDS) as temporary:
        temporary.write_text(json.dumps({"seconds": seconds}) + "\n", encoding="utf-8")
    yield MethodFolder(method, folder, seconds, False, output_folder.read_record(folder).notes)


def _is_reusable(folder: Path, record: TransferRecord) -> bool:
    if not output_folder.is_transferred_folder(folder):
        return False
    try:
        there = output_folder.read_record(folder)
    except CaptureError:
        return False
    return (there.method, there.made_of, dict(there.settings)) == (record.method, record.made_of, dict(record.settings))


def capture_source(capture: Capture, width_px: int, source_stamp: str) -> ComparedSource:
    """Use the images of a capture; wider ones are downscaled to `width_px`."""
    views = CaptureViews(capture, width_px)
    return ComparedSource(
        capture.name, views, ImageEnvironment(), views.to_world, views.mask, capture.has_poses, source_stamp
    )


def held_out_images(
    settings: ImageSettings, width_px: int, weights: Iterable[Path] = ()
) -> tuple[ComparedSource, Capture]:
    """Return the clear and the rainy images that a training with these settings holds out.

    They are not cropped as in training: extractors resize them without keeping proportions, like the paper. Raises
    `CaptureError` for an unreadable source, and ValueError if nothing is held out, or if `weights` were trained with
    another split, as they may have seen these images.
    """
    split = open_images(msgspec.structs.replace(settings, guide="none"))
    held_out = identity_of(split.test)
    for file in weights:
        if (record := read_record(file)) is not None and record.held_out not in ("", held_out):
            raise ValueError(
                f"{file}: trained with other pictures held out ({record.held_out}) than are compared ({held_out}): "
                "take the `pictures` of the training's config.yaml"
            )
    if not split.test.source or not split.test.target:
        raise ValueError(f"pictures: test_share {settings.test_share:g} leaves no clear or no rainy picture to test")
    stamps = "-".join(input_fingerprint(Path(each.path)) for each in settings.clear)
    clear = _unrelated("clear test pictures", split.test.source)
    rainy = _unrelated("rainy test pictures", split.test.target)
    return capture_source(clear, width_px, stamps), _narrowed(rainy, width_px)


def real_images(folders: Sequence[Path], width_px: int) -> Capture:
    """Return the images of some folders or captures, at most as wide as the transferred ones.

    An additional downscaling would change an extractor's features. Raises `CaptureError` if one can't be read.
    """
    captures = [open_capture(folder) for folder in folders]
    return _narrowed(replace(captures[0], views=tuple(view for each in captures for view in each)), width_px)


def _unrelated(name: str, pictures: Sequence[DatasetImage]) -> Capture:
    """A capture of unrelated images from several sources."""
    views = tuple(replace(each.view, name=flat_name(each.name), sensor="") for each in pictures)
    return Capture(name, views, is_metric=False, has_poses=False)


def _narrowed(capture: Capture, width_px: int) -> Capture:
    return replace(capture, views=tuple(undistort_frame(view, min(width_px, view.camera.width)) for view in capture))


# Comparison figure
# One row per method, one column per view.

_CELL_PX, _GAP_PX, _TEXT_PX = 360, 8, 18
_PAPER, _INK, _FAINT, _EMPTY = (255, 255, 255), (20, 20, 22), (110, 112, 118), (236, 236, 238)


def choose_figure_views(
    folders: Sequence[MethodFolder], names: Sequence[str], columns: int, sensors: Sequence[str] = ()
) -> list[str]:
    """The named views, or `columns` even ones of the method with the most; raises ValueError for an unknown name.

    If there is a column for each of several cameras, the views are those of one moment in the middle, in the order of
    `sensors`. Names of recorded views end with their camera.
    """
    there = max(([view.clear.name for view in read_transferred(each.folder)] for each in folders), key=len)
    if not names:
        if columns == len(sensors) > 1:
            first = len(there) // columns // 2 * columns
            moment = {name.partition("_")[2]: name for name in there[first : first + columns]}
            if moment.keys() == set(sensors):
                return [moment[sensor] for sensor in sensors]
        return [there[i] for i in evenly_spaced_indices(len(there), columns)]
    for name in names:
        if name not in there:
            raise ValueError(f"shown: no view {name!r}, for one {there[0]!r}")
    return list(names)


def comparison_figure(folders: Sequence[MethodFolder], names: Sequence[str]) -> UInt8[np.ndarray, "h w 3"]:
    """Draw the named views of each method; a missing view stays empty."""
    rows: list[tuple[str, list[UInt8[np.ndarray, "_ _ 3"] | None]]] = []
    for each in folders:
        views = {view.clear.name: view for view in read_transferred(each.folder) if view.clear.name in names}
        images = {name: np.rint(255 * view.image).astype(np.uint8) for name, view in views.items()}
        rows.append((each.method.name, [images.get(name) for name in names]))
    ratios = [one.shape[0] / one.shape[1] for _, pictures in rows for one in pictures if one is not None]
    tall = round(_CELL_PX * max(ratios, default=0.5))
    line, step = _TEXT_PX + _GAP_PX, tall + _TEXT_PX + 3 * _GAP_PX
    head = line + _GAP_PX
    size = (len(names) * (_CELL_PX + _GAP_PX) + _GAP_PX, head + len(rows) * step)
    sheet = Image.new("RGB", size, _PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(_TEXT_PX)
    lefts = [_GAP_PX + column * (_CELL_PX + _GAP_PX) for column in range(len(names))]
    for left, name in zip(lefts, names, strict=True):
        title = name
        while draw.textlength(title, font) > _CELL_PX and len(title) > 2:  # frame names of a drive differ at their ends
            title = f"…{title[2:]}"
        draw.text((left, _GAP_PX // 2), title, _FAINT, font)
    for row, (method, pictures) in enumerate(rows):
        top = head + row * step
        draw.text((_GAP_PX, top), method, _INK, font)
        for left, picture in zip(lefts, pictures, strict=True):
            box = (left, top + line, left + _CELL_PX, top + line + tall)
            if picture is None:
                draw.rectangle(box, _EMPTY)
                draw.text((left + _GAP_PX, box[1] + _GAP_PX), "no picture", _FAINT, font)
            else:
                scale = _CELL_PX / picture.shape[1]
                size = (_CELL_PX, max(round(picture.shape[0] * scale), 1))
                filtered = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
                sheet.paste(Image.fromarray(cv2.resize(picture, size, interpolation=filtered)), box[:2])
    return np.asarray(sheet)
