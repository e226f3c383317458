"""Rain presets: YAML files with the fields of `Rain`, those left out at their defaults."""

from gsrain_engine.shipped_configs import load_config, shipped_names

from .calibration import calibration_names
from .rain import Rain

_FOLDER = "rain"
_ORDER = ("clear", "1.2", "8.5", "12.0", "paper")


def preset_names() -> list[str]:
    """Names of the shipped presets, weakest first."""
    names = shipped_names(_FOLDER)
    return [name for name in _ORDER if name in names] + [name for name in names if name not in _ORDER]


def load_preset(name: str) -> Rain:
    """Load a shipped preset by name, or a preset file by path.

    A calibration file that it names is looked for in its own folder first. Raises `ValueError` with the file, the field
    and the allowed range.
    """
    return load_config(_FOLDER, name, Rain, "preset", ("calibration",), calibration_names())
