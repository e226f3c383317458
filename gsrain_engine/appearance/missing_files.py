"""Files that a transfer lacks on this machine, found before any work, so that one error names all."""

from pathlib import Path

from ..safe_io.errors import not_found
from .base import TransferSettings, follow_training
from .cyclegan_turbo.weight_paths import find_transfer_weights, find_whole_base_model, has_random_base, read_record
from .normals import ESTIMATORS, missing_estimator_files
from .registry import find_method

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
