"""`gsrain schema KIND`: JSON schemas of settings files, for editors that complete and check YAML."""

import json
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from gsrain_engine import plugins
from gsrain_engine.fields import schema_of
from gsrain_engine.report.numbers import write_text

from .console import print_lines
from .options import option
from .outputs import check_writable

SETTINGS = {
    "rain": ("gsrain_engine.rain.settings:RainSettings", "Rain presets"),
    "calibrations": ("gsrain_engine.rain.calibration:Calibration", "Rain calibrations"),
    "sensors": ("gsrain_engine.scene.sensor:Sensor", "Image sensors and lenses"),
    "scenarios": ("gsrain_engine.simulation.scenario:Scenario", "Scenarios of `gsrain drive`"),
    "sweeps": ("gsrain_engine.sweep.settings:Sweep", "Sweeps"),
    "reconstruct": ("gsrain_engine.training.settings:TrainingSettings", "Reconstruction"),
    "finetune": ("gsrain_engine.appearance.finetune.settings:FinetuningSettings", "Fine-tuning of a transfer"),
    "comparisons": ("gsrain_engine.evaluation.compare_results:TransferComparison", "Comparisons of transfers"),
    "detectors": ("gsrain_engine.evaluation.detection.description:DetectorDescription", "Detector descriptions"),
}
"""Type and title of each kind of settings file, by its folder in sample_configs."""

Kind = Literal[*SETTINGS, *(each.name for each in plugins.find_extensions(plugins.SETTINGS))]


def settings_type(kind: str) -> type[msgspec.Struct]:
    """Return the type of a kind of settings file. Raises `ExtensionError` if that of a package is unusable."""
    if kind in SETTINGS:
        module, _, name = SETTINGS[kind][0].partition(":")
        return getattr(import_module(module), name)
    extension = next(each for each in plugins.find_extensions(plugins.SETTINGS) if each.name == kind)
    found = extension.load(type)
    if not issubclass(found, msgspec.Struct):
        raise extension.unfit(f"is the class {found.__name__}, not a struct of msgspec")
    return found


def schema(
    kind: Annotated[Kind, option("Kind of file: its folder in sample_configs.")],
    /,
    *,
    output: Annotated[Path | None, option("Write the schema to this file.", "--output", "-o")] = None,
) -> None:
    """Print the JSON schema of a kind of settings file: fields with title, unit, bounds, default and help.

    An editor with a YAML language server completes and checks a file whose first line is
    `# yaml-language-server: $schema=rain.json`.
    """
    check_writable(output)
    text = json.dumps(schema_of(settings_type(kind)), indent=1)
    if output is None:
        print_lines(text)
    else:
        write_text(output, text + "\n")
