"""Rain presets: YAML files with the fields of `Rain`, those left out at their defaults."""

from importlib import resources
from pathlib import Path

import msgspec

from .rain import Rain

_ORDER = ("clear", "1.2", "8.5", "12.0", "paper")


def preset_names() -> list[str]:
    """Names of the shipped presets, weakest first."""
    folder = resources.files("sample_configs").joinpath("rain")
    names = {file.name.removesuffix(".yaml") for file in folder.iterdir() if file.name.endswith(".yaml")}
    return [name for name in _ORDER if name in names] + sorted(names - set(_ORDER))


def load_preset(name: str) -> Rain:
    """Load a shipped preset by name, or a preset file by path.

    Raises `ValueError` with the file, the field and the allowed range.
    """
    if name in preset_names():
        data = resources.files("sample_configs").joinpath("rain", f"{name}.yaml").read_bytes()
        where = f"preset {name}"
    else:
        path = Path(name)
        if not path.is_file():
            known = ", ".join(preset_names())
            raise ValueError(f"preset {name!r}: no such file, and none of the shipped ones ({known})")
        data, where = path.read_bytes(), str(path)
    try:
        return msgspec.yaml.decode(data, type=Rain)
    except msgspec.MsgspecError as error:
        raise ValueError(f"{where}: {error}") from None
