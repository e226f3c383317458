"""What is compared with what: one value, which is a YAML file."""

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from gsrain_engine.appearance.finetuning.pictures.settings import PictureSettings
from gsrain_engine.appearance.methods import method_names
from gsrain_engine.appearance.normals.dsine_checkout import check_checkout
from gsrain_engine.appearance.transfer_settings import TransferSettings
from gsrain_engine.appearance.views.choice import ViewChoice
from gsrain_engine.scene.open_scene import STREET
from gsrain_engine.shipped_configs import load_values
from gsrain_engine.untrusted.explained_errors import converted
from gsrain_engine.untrusted.printable import printable

CLEAR = "clear"
"""The method that changes nothing: how far clear pictures are from rainy ones."""

SHIPPED = "comparisons"
"""Folder of sample_configs with the comparisons that the program ships."""

USUAL_WIDTH_PX = 512
"""Of all pictures where nothing is said: the paper's."""

_FILES = (
    *("source", "capture", "real", "path", "extractor_weights"),
    *("weights", "images", "base", "normals_weights", "normals_checkout"),
)
"""Fields that name files."""

_FIELDS = TransferSettings.__struct_fields__


class ComparedMethod(TransferSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One row: a transfer with its settings under a name; settings that its method does not take change nothing."""

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
        """The transfer's own settings."""
        return TransferSettings(**{field: getattr(self, field) for field in _FIELDS})


class Comparison(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Views, real rainy pictures, and methods that make the views rainy.

    Views are those of `source`, then `real` says what is rainy, or those of `pictures`: the part of them that its
    training has never seen, clear and rainy.
    """

    methods: Annotated[tuple[ComparedMethod, ...], Meta(min_length=1, title="Methods")]
    source: Annotated[str | None, Meta(title="Source", description="A scene, street, or a capture.")] = None
    capture: Annotated[
        Path | None, Meta(title="Capture", description="Where a scene's recorded cameras come from.")
    ] = None
    real: Annotated[
        tuple[Path, ...], Meta(title="Real", description="Folders or captures of rainy pictures that cameras took.")
    ] = ()
    pictures: Annotated[
        PictureSettings | None, Meta(title="Pictures", description="As a training has them; its test part is taken.")
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
        int, Meta(ge=1, le=16, title="Neighbours", description="That each view is compared with for consistency.")
    ] = 2
    columns: Annotated[int, Meta(ge=1, le=12, title="Columns", description="Views on the figure, evenly.")] = 4
    shown: Annotated[
        tuple[str, ...], Meta(title="Shown", description="Names of the figure's views instead, in this order.")
    ] = ()

    @property
    def width_px(self) -> int:
        """Of all pictures that are compared, at most."""
        return self.views.width_px or USUAL_WIDTH_PX

    def only(self, names: tuple[str, ...]) -> "Comparison":
        """Keep the methods of these names; raises ValueError for a name that there is not."""
        there = {each.name: each for each in self.methods}
        for name in names:
            if name not in there:
                raise ValueError(f"no method {name!r}, only {', '.join(there)}")
        return msgspec.structs.replace(self, methods=tuple(each for each in self.methods if each.name in names))


def load_comparison(name: str | Path) -> Comparison:
    """Read a comparison from a file, or a shipped one by its name.

    Files that it names are looked for in its own folder first, then in the working folder. Raises ValueError, which
    names the file, the field, and what would be right; `UntrustedCodeError` where it names a program that no person has
    allowed to run.
    """
    values = load_values(SHIPPED, name, "comparison", _FILES, {STREET})
    try:
        comparison = converted(values, Comparison, dec_hook=_path)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    problem = _problem(comparison)
    if problem is not None:
        raise ValueError(f"{name}: {printable(problem)}")
    for each in (*comparison.methods, *([comparison.pictures] if comparison.pictures is not None else [])):
        check_checkout(name, each.normals, each.normals_checkout)
    return comparison


def _path(kind: type, value: object) -> Path:
    """Make paths of text, which msgspec leaves to its user."""
    if kind is not Path or not isinstance(value, str):
        raise ValueError(f"Expected `path`, got `{type(value).__name__}`")
    return Path(value)


def _problem(comparison: Comparison) -> str | None:
    if (comparison.source is None) == (comparison.pictures is None):
        return "expected either source or pictures - at `$.source`"
    if comparison.pictures is not None and comparison.real:
        return "pictures have rainy ones of their own, real goes with source - at `$.real`"
    if comparison.source is not None and not comparison.real:
        return "expected folders of real rainy pictures - at `$.real`"
    known = [CLEAR, *method_names()]
    taken: set[str] = set()
    for i, each in enumerate(comparison.methods):
        if each.method not in known:
            return f"no method {each.method!r}, only {', '.join(known)} - at `$.methods[{i}].method`"
        if each.name.lower() in taken:  # folders of such names are one on some disks
            return f"{each.name!r} is there twice - at `$.methods[{i}].name`"
        taken.add(each.name.lower())
    return None
