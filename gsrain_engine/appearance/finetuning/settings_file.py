"""Reads the settings of a fine-tuning: shipped ones by name, a person's by path, with changes on top."""

from pathlib import Path
from typing import Any, get_type_hints

import msgspec

from gsrain_engine.appearance.normals.dsine_checkout import check_checkout, checkout_code
from gsrain_engine.shipped_configs import load_values, shipped_names
from gsrain_engine.untrusted.explained_errors import converted

from .settings import FinetuningSettings

_FOLDER = "finetune"
_FILES = ("path", "normals_weights", "normals_checkout", "base", "clip", "lpips", "start")
"""Fields that name files."""


def load_finetuning(name: str | Path, **changes: Any) -> FinetuningSettings:
    """Read settings, and change some; changes that are None are passed over.

    Files that it names are looked for in its own folder first, then in the working folder. Raises ValueError with the
    file or option, the field and what is allowed; `UntrustedCodeError` where they name a program that no person has
    allowed to run.
    """
    values = load_values(_FOLDER, name, "settings", _FILES)
    changed = {key: value for key, value in changes.items() if value is not None}
    if isinstance(pictures := values.get("pictures", {}), dict):
        sources = {look: changed.pop(look) for look in ("clear", "rainy") if look in changed}
        values["pictures"] = pictures | sources
    try:
        settings: FinetuningSettings = converted(values | changed, FinetuningSettings)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    check_checkout(name, settings.pictures.normals, settings.pictures.normals_checkout)
    return settings


def code_of(settings: FinetuningSettings) -> dict[str, str]:
    """Digests of the Python that settings name, by its absolute path: for the process that runs it."""
    pictures = settings.pictures
    if pictures.normals != "dsine" or pictures.normals_checkout is None:
        return {}
    code = checkout_code(Path(pictures.normals_checkout))
    return {str(code.path): code.digest}


def finetuning_help(name: str) -> str:
    """Description of a setting, for the help of a command that changes it."""
    hint = get_type_hints(FinetuningSettings, include_extras=True)[name]
    return f"{hint.__metadata__[-1].description} Default: what CONFIG says."


def finetuning_names() -> list[str]:
    return shipped_names(_FOLDER)


def write_finetuning(file: Path, settings: FinetuningSettings) -> None:
    """Write settings as a YAML file that `load_finetuning` reads."""
    file.write_bytes(msgspec.yaml.encode(settings))
