"""Table of transfer methods, built in and from installed packages; each is loaded on first use."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..plugins import TRANSFERS, Extension, ExtensionError, find_extension, find_extensions, warn_once
from ..safe_io.errors import not_found
from .base import Transfer, TransferSettings, follow_training
from .cyclegan_turbo.weight_paths import find_transfer_weights, find_whole_base_model, has_random_base, read_record
from .normals import ESTIMATORS, missing_estimator_files

if TYPE_CHECKING:
    from .wet_look.environment import ReflectionEnvironment


@dataclass(frozen=True, slots=True)
class TransferMethod:
    """Table row of a transfer method."""

    name: str
    title: str
    help: str
    opens: Callable[[TransferSettings, "ReflectionEnvironment"], Transfer]
    needs_torch: bool = False
    needs: str | None = None
    """Settings field that must be set to open the method."""
    uses: tuple[str, ...] = ()
    """Settings fields that apply to the method, in panel order."""


def open_transfer(name: str, settings: TransferSettings, surroundings: "ReflectionEnvironment") -> Transfer:
    """Open a transfer method; `surroundings` are the source of reflections for the wet look.

    Raises ValueError for an unknown name or a missing required setting.
    """
    method = find_method(name)
    if method.needs is not None and getattr(settings, method.needs) is None:
        raise ValueError(f"--method {name} needs --{method.needs}")
    return method.opens(settings, surroundings)


def find_method(name: str) -> TransferMethod:
    """Find a method by its name.

    Raises ValueError for an unknown name; the message lists the methods. For an unusable method of an installed
    package it is an `ExtensionError`.
    """
    if (own := next((each for each in METHODS if each.name == name), None)) is not None:
        return own
    if (installed := find_extension(TRANSFERS, name)) is not None:
        return _installed(installed)
    raise ValueError(f"no transfer method {name!r}, only {', '.join(method_names())}")


def method_names() -> tuple[str, ...]:
    """Names of all methods, built-in ones first."""
    ours = tuple(each.name for each in METHODS)
    return (*ours, *(each.name for each in find_extensions(TRANSFERS) if each.name not in ours))


def usable_methods() -> tuple[TransferMethod, ...]:
    """All methods, built-in ones first; unusable ones of installed packages are skipped and logged."""
    usable: list[TransferMethod] = []
    for name in method_names():
        try:
            usable.append(find_method(name))
        except ExtensionError as error:
            warn_once(str(error))
    return tuple(usable)


def _installed(extension: Extension) -> TransferMethod:
    """Return the row of another package, with `opens` wrapped so that each failure is one sentence."""
    row = extension.load(TransferMethod)
    if row.name != extension.name:
        raise extension.unfit(f"calls itself {row.name}")
    if unknown := sorted({*row.uses, *filter(None, [row.needs])} - set(TransferSettings.__struct_fields__)):
        raise extension.unfit(f"there is no setting {unknown[0]} of a transfer")

    def opens(settings: TransferSettings, surroundings: "ReflectionEnvironment") -> Transfer:
        try:
            transfer = row.opens(settings, surroundings)
        except Exception as error:  # third-party code may raise anything
            raise extension.unfit(error) from error
        if not isinstance(transfer, Transfer):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise extension.unfit(f"opens a {type(transfer).__name__}, which has no name or no method transferred")
        return transfer

    return replace(row, opens=opens)


def _wet(settings: TransferSettings, surroundings: "ReflectionEnvironment") -> Transfer:
    from .wet_look.settings import WetSettings
    from .wet_look.translator import WetTransfer

    return WetTransfer(WetSettings(wetness=settings.wetness, seed=settings.seed), surroundings)


def _cyclegan_turbo(settings: TransferSettings, surroundings: "ReflectionEnvironment") -> Transfer:
    from .cyclegan_turbo.translator import open_cyclegan_turbo  # torch is an extra

    return open_cyclegan_turbo(settings)


def _images(settings: TransferSettings, surroundings: "ReflectionEnvironment") -> Transfer:
    from .output_folder import PrecomputedTransfer

    assert settings.images is not None
    return PrecomputedTransfer(settings.images)


METHODS = (
    TransferMethod("wet", "Wet look", "Computed from light, depth and normals; needs no weights.", _wet,
                   uses=("seed",)),
    TransferMethod(
        "cyclegan-turbo", "CycleGAN-Turbo", "The paper's diffusion model; needs its weights and torch.",
        _cyclegan_turbo, needs_torch=True,
        uses=("weights", "base", "normals", "normals_weights", "normals_checkout", "guide", "framing", "override",
              "mutual_attention", "neighbours", "side_px", "tile_px", "precision", "device"),
    ),
    TransferMethod(
        "images", "Pictures", "Pictures that another program has made of the same views.", _images, needs="images",
        uses=("images",),
    ),
)  # fmt: skip


# Files that a transfer lacks on this machine, found before any work, so that one error names all

TRANSFER_FILES = ("weights", "base", "images", "normals_weights", "normals_checkout")
"""Fields of `TransferSettings` that name a file or folder."""


def missing_for_transfer(method: str, settings: TransferSettings) -> list[str]:
    """Name every file, folder and setting that a transfer lacks, with its option and how to get it; a line each.

    Weights count as missing too if their record contradicts the settings. Loads no torch.
    """
    missing: list[str] = []
    needs = find_method(method).needs
    if needs is not None and getattr(settings, needs) is None:
        missing.append(f"--method {method} needs --{needs}")
    is_learned, needs_base, weights = method == "cyclegan-turbo", True, settings.weights
    if is_learned and weights is None:
        missing += not_found(find_transfer_weights)
    elif is_learned and weights is not None and weights.exists():
        try:
            settings = follow_training(settings, read_record(weights), weights)
            needs_base = not has_random_base(weights)
        except ValueError as error:
            missing.append(str(error))
    is_estimated = is_learned and settings.normals in ESTIMATORS
    for field in TRANSFER_FILES:
        path: Path | None = getattr(settings, field)
        if path is not None and not path.exists() and not (is_estimated and field.startswith("normals")):
            missing.append(f"--{field.replace('_', '-')} {path}: no such file or folder")
    if is_estimated and settings.normals is not None:
        missing += missing_estimator_files(settings.normals, settings.normals_weights, settings.normals_checkout)
    if is_learned and needs_base and (settings.base is None or settings.base.exists()):
        missing += not_found(find_whole_base_model, settings.base)
    return missing
