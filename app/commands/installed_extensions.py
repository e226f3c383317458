"""What `gsrain doctor` says about the extensions of other installed packages: each is loaded as the program would."""

from collections.abc import Callable
from pathlib import Path

from gsrain_engine.extensions import (
    AGENTS,
    CAPTURE_FORMATS,
    DECODERS,
    DISDROMETERS,
    EVALUATIONS,
    GROUPS,
    PANELS,
    SCENE_FORMATS,
    TRANSFERS,
    Extension,
    Group,
    extensions,
)


def installed_extensions() -> list[Extension]:
    """Return all that there are, kind by kind."""
    return [each for group in GROUPS for each in extensions(group)]


def describe(extension: Extension) -> str:
    """Load one, and say where it comes from. Raises ValueError, with one sentence, where it can't be used."""
    _CHECKS[extension.group](extension)
    return f"{extension.place} of {extension.package} {extension.version}".rstrip()


def _scene_format(extension: Extension) -> None:
    from gsrain_engine.scene.formats.gaussian_files import format_of

    format_of(Path(f"scene.{extension.name}"))


def _transfer(extension: Extension) -> None:
    from gsrain_engine.appearance.methods import method_of

    method_of(extension.name)


def _decoder(extension: Extension) -> None:
    from gsrain_engine.evaluate.detection.decoders import decoder

    decoder(extension.name)


def _panel(extension: Extension) -> None:
    from ui.panels.panel import Panel

    extension.load(Panel)


def _disdrometer(extension: Extension) -> None:
    from gsrain_engine.rain.disdrometer.installed_logs import LogFormat

    extension.load(LogFormat)


def _capture_format(extension: Extension) -> None:
    from gsrain_engine.datasets.open_capture import CaptureFormat

    extension.load(CaptureFormat)


_CHECKS: dict[Group, Callable[[Extension], object]] = {
    AGENTS: Extension.load_callable,
    CAPTURE_FORMATS: _capture_format,
    DECODERS: _decoder,
    DISDROMETERS: _disdrometer,
    EVALUATIONS: Extension.load_callable,
    PANELS: _panel,
    SCENE_FORMATS: _scene_format,
    TRANSFERS: _transfer,
}
