"""Reads the settings of a fine-tuning: shipped ones by name, a person's by path, with changes on top."""

from importlib import resources
from pathlib import Path
from typing import Any, get_type_hints

import msgspec

from .settings import FinetuningSettings


def load_finetuning(name: str | Path, **changes: Any) -> FinetuningSettings:
    """Read settings, and change some; changes that are None are passed over.

    Raises ValueError with the file or option, the field and what is allowed.
    """
    values = _read(str(name))
    changed = {key: value for key, value in changes.items() if value is not None}
    if isinstance(pictures := values.get("pictures", {}), dict):
        sources = {look: changed.pop(look) for look in ("clear", "rainy") if look in changed}
        values["pictures"] = pictures | sources
    try:
        return msgspec.convert(values | changed, FinetuningSettings)
    except msgspec.ValidationError as error:
        raise ValueError(f"{name}: {error}") from None


def finetuning_help(name: str) -> str:
    """Description of a setting, for the help of a command that changes it."""
    hint = get_type_hints(FinetuningSettings, include_extras=True)[name]
    return f"{hint.__metadata__[-1].description} Default: what CONFIG says."


def finetuning_names() -> list[str]:
    """Names of the shipped settings."""
    folder = resources.files("sample_configs").joinpath("finetune")
    return sorted(file.name.removesuffix(".yaml") for file in folder.iterdir() if file.name.endswith(".yaml"))


def write_finetuning(file: Path, settings: FinetuningSettings) -> None:
    """Write settings as a YAML file that `load_finetuning` reads."""
    file.write_bytes(msgspec.yaml.encode(settings))


def _read(name: str) -> dict[str, Any]:
    if name in finetuning_names():
        data = resources.files("sample_configs").joinpath("finetune", f"{name}.yaml").read_bytes()
    else:
        path = Path(name)
        if not path.is_file():
            known = ", ".join(finetuning_names())
            raise ValueError(f"{name}: no such file, and none of the shipped settings ({known})")
        data = path.read_bytes()
    try:
        values = msgspec.yaml.decode(data)
    except msgspec.MsgspecError as error:
        raise ValueError(f"{name}: {error}") from None
    if not isinstance(values, dict):
        raise ValueError(f"{name}: expected a YAML mapping of settings such as `steps: 20000`")
    return {str(key): value for key, value in values.items()}
