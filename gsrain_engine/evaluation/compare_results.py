"""Settings and results of a comparison of rain translators: view agreement, table rows, Markdown and CSV."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from ..appearance.base import TransferSettings
from ..appearance.dsine_checkout import check_checkout
from ..appearance.finetune.dataset import ImageSettings
from ..appearance.registry import method_names
from ..appearance.view_choice import ViewChoice
from ..presets import load_values
from ..report.table import Cell, Column, Table
from ..safe_io.errors import convert_checked
from ..safe_io.text_files import printable_line
from ..scene.built_in import DEFAULT_SCENE
from .consistency import WarpAgreement, agreements, open_view_folder, pool_errors
from .fid import DistributionDistance


class ComparisonPairs:
    """The pairs of neighboring views that all methods are measured on."""

    def __init__(self, folders: Sequence[Path], neighbours: int) -> None:
        """Find the pairs in the first folder with the most views; raises `CaptureError` for a broken folder."""
        opened = [open_view_folder(folder) for folder in folders]
        fullest = max(opened, key=lambda each: len(each.views))
        names = fullest.names
        self._pairs = [(names[i], names[j]) for i, j in fullest.chosen(neighbours)]

    def agreement(self, folder: Path) -> tuple[int, WarpAgreement | None, WarpAgreement | None]:
        """Return the number of pairs, and their pooled agreement everywhere and outside the water film.

        See `warp_error`: display values of 0..1, 0 is best, and a ratio of 1 means no change. Pairs with a missing view
        are omitted; None if no pair remains or the film is unknown.
        """
        compared = open_view_folder(folder)
        index = {name: i for i, name in enumerate(compared.names)}
        pairs = [(index[of], index[to]) for of, to in self._pairs if of in index and to in index]
        rows = list(agreements(compared.views, pairs, has_clear=compared.has_clear))
        dry = [row.outside_film for row in rows if row.outside_film is not None]
        return len(rows), pool_errors(row.everywhere for row in rows), pool_errors(dry)


# Comparison table

_KERNEL_SCALE, _LEVELS = 1000, 255


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedRow:
    """Results of one method."""

    name: str
    method: str
    distance: DistributionDistance
    pairs: int = 0
    everywhere: WarpAgreement | None = None
    """Of neighboring views; None if their cameras are unknown or no views overlap."""
    outside_film: WarpAgreement | None = None
    seconds: float | None = None
    """Duration of its transfer, if it ran."""


def comparison_table(rows: Sequence[ComparedRow]) -> Table:
    """Return the table of a comparison.

    The Frechet distance (>= 0, 0 is best) is named FID for Inception's features alone, else FD- and the extractor; the
    kernel distance (0 is best) KID or KD-, times 1000. "same" is the expected Frechet distance of two equally large
    sets from one distribution. Errors are the root mean square between neighboring views warped onto each other, in
    levels of 255 (0 is best), and "ratio" after over before (1 means no change); "per contrast" divides by contrast,
    since a transfer that grays everything lowers errors; "dry" is outside the water film. Sources:
    `distribution_distance` and `agreements`.
    """
    distance = rows[0].distance
    titled = (
        Column("method"), Column("N"), Column("N real"), Column(distance.metric, ".4g"), Column("same", ".4g"),
        Column(f"{distance.kernel_metric} x1000", ".4g"), Column("pairs"), Column("error before", ".4g"),
        Column("error after", ".4g"), Column("ratio", ".4g"), Column("per contrast", ".4g"),
        Column("dry ratio", ".4g"), Column("seconds", ".4g"),
    )  # fmt: skip
    values: list[tuple[Cell, ...]] = []
    for row in rows:
        own = row.distance
        before, after, ratio, contrast_ratio = _errors(row.everywhere)
        values.append((
            row.name, own.fake_pictures, own.real_pictures, own.frechet, own.same, own.kernel.scaled(_KERNEL_SCALE),
            row.pairs, None if before is None else _LEVELS * before, None if after is None else _LEVELS * after,
            ratio, contrast_ratio, _errors(row.outside_film)[2], row.seconds,
        ))  # fmt: skip
    caption = (
        f'Compared with real pictures by {distance.extractor}. "same": what the distance would be of two sets so large '
        "of one distribution. Errors: neighboring views warped onto each other, in levels of 255; ratio: to that "
        "before; dry: outside the water film."
    )
    return Table("Methods", titled, values, caption)


def plain_row(row: ComparedRow) -> dict[str, Any]:
    """Return a row for JSON, with its extractor and warnings."""
    distance = row.distance
    before, after, ratio, contrast_ratio = _errors(row.everywhere)
    return {
        "name": row.name,
        "method": row.method,
        "metric": distance.metric,
        "kernel_metric": distance.kernel_metric,
        "extractor": distance.extractor,
        "real_pictures": distance.real_pictures,
        "fake_pictures": distance.fake_pictures,
        **distance.plain,
        "pairs": row.pairs,
        "rmse_before": before,
        "rmse_after": after,
        "ratio": ratio,
        "contrast_ratio": contrast_ratio,
        "dry_ratio": _errors(row.outside_film)[2],
        "seconds": row.seconds,
        "warnings": list(distance.warnings),
    }


def _errors(agreement: WarpAgreement | None) -> tuple[float | None, float | None, float | None, float | None]:
    """Errors before and after, their ratio, and that per contrast; None if unknown, since JSON has no NaN."""
    if agreement is None:
        return None, None, None, None
    ratio, contrast_ratio = (None if isnan(each) else each for each in (agreement.ratio, agreement.contrast_ratio))
    before = None if agreement.before is None else agreement.before.rmse
    return before, agreement.after.rmse, ratio, contrast_ratio


# Comparison settings
# Also the schema of the YAML file.

CLEAR = "clear"  # the method that changes nothing: baseline distance of clear images to rainy ones
SHIPPED = "comparisons"  # folder of sample_configs with the shipped comparisons
_FILES = (
    *("source", "capture", "real", "path", "extractor_weights"),
    *("weights", "images", "base", "normals_weights", "normals_checkout"),
)


class ComparedMethod(TransferSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One row: a transfer with its settings under a name; settings that its method does not use have no effect."""

    name: Annotated[
        str,
        Meta(
            pattern=r"^[A-Za-z0-9][A-Za-z0-9 _.+-]*$",
            max_length=60,
            title="Name",
            description="In the table; its pictures go into a folder of this name.",
        ),
    ]
    method: Annotated[str, Meta(title="Method", description="clear, or one of those of gsrain transfer.")]

    @property
    def settings(self) -> TransferSettings:
        return TransferSettings(**{field: getattr(self, field) for field in TransferSettings.__struct_fields__})


class TransferComparison(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Views, real rainy images, and methods that make the views rainy.

    Views come from `source`, with rainy images from `real`, or from `pictures`: clear and rainy images of its held-out
    test part.
    """

    methods: Annotated[tuple[ComparedMethod, ...], Meta(min_length=1, title="Methods")]
    source: Annotated[str | None, Meta(title="Source", description="A scene, street, or a capture.")] = None
    capture: Annotated[
        Path | None, Meta(title="Capture", description="Capture that a scene's recorded cameras are read from.")
    ] = None
    real: Annotated[
        tuple[Path, ...], Meta(title="Real", description="Folders or captures of rainy pictures that cameras took.")
    ] = ()
    pictures: Annotated[
        ImageSettings | None, Meta(title="Pictures", description="As a training has them; its test part is taken.")
    ] = None
    views: Annotated[ViewChoice, Meta(title="Views", description="Of the source; pictures only take its width.")] = (
        ViewChoice()
    )
    extractor: Annotated[str, Meta(title="Extractor", description="As gsrain evaluate fid has it.")] = "inception"
    extractor_weights: Annotated[
        Path | None, Meta(title="Extractor's weights", description="None: those of this machine.")
    ] = None
    resamples: Annotated[int, Meta(ge=20, le=10_000, title="Resamples", description="For the intervals.")] = 200
    seed: Annotated[int, Meta(ge=0, le=2**31 - 1, title="Seed", description="Of the intervals.")] = 0
    neighbours: Annotated[
        int,
        Meta(
            ge=1,
            le=16,
            title="Neighbors",
            description="Number of views that each view is compared with for consistency.",
        ),
    ] = 2
    columns: Annotated[int, Meta(ge=1, le=12, title="Columns", description="Views on the figure, evenly.")] = 4
    shown: Annotated[
        tuple[str, ...], Meta(title="Shown", description="Names of the figure's views instead, in this order.")
    ] = ()

    @property
    def width_px(self) -> int:
        """Maximum width of all compared images: the paper's by default."""
        return self.views.width_px or 512

    def only(self, names: tuple[str, ...]) -> "TransferComparison":
        """Keep the methods of these names, in this order, each once; raises ValueError for an unknown name."""
        there = {each.name: each for each in self.methods}
        for name in names:
            if name not in there:
                raise ValueError(f"no method {name!r}, only {', '.join(there)}")
        return msgspec.structs.replace(self, methods=tuple(there[name] for name in dict.fromkeys(names)))


def load_comparison(name: str | Path) -> TransferComparison:
    """Read a comparison from a file, or a shipped one by its name.

    Files that it names are searched in its own folder first, then in the working folder. Raises ValueError with the
    file, the field and the expected value; `UntrustedCodeError` if it names a program that the user has not trusted.
    """
    values = load_values(SHIPPED, name, "comparison", _FILES, {DEFAULT_SCENE})
    try:
        comparison = convert_checked(values, TransferComparison, dec_hook=_path)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    problem = _problem(comparison)
    if problem is not None:
        raise ValueError(f"{name}: {printable_line(problem)}")
    for each in (*comparison.methods, *([comparison.pictures] if comparison.pictures is not None else [])):
        check_checkout(name, each.normals, each.normals_checkout)
    return comparison


def _path(kind: type, value: object) -> Path:
    """Convert text to paths, which msgspec does not."""
    if kind is not Path or not isinstance(value, str):
        raise ValueError(f"Expected `path`, got `{type(value).__name__}`")
    return Path(value)


def _problem(comparison: TransferComparison) -> str | None:
    if (comparison.source is None) == (comparison.pictures is None):
        return "expected either source or pictures - at `$.source`"
    if comparison.pictures is not None and comparison.real:
        return "pictures have rainy ones of their own, real goes with source - at `$.real`"
    if comparison.source is not None and not comparison.real:
        return "expected folders of real rainy pictures - at `$.real`"
    known = [CLEAR, *method_names()]
    names: set[str] = set()
    for i, each in enumerate(comparison.methods):
        if each.method not in known:
            return f"no method {each.method!r}, only {', '.join(known)} - at `$.methods[{i}].method`"
        if each.name.lower() in names:  # some disks ignore case in folder names
            return f"{each.name!r} is there twice - at `$.methods[{i}].name`"
        names.add(each.name.lower())
    return None
