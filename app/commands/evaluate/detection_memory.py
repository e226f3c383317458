"""What `gsrain evaluate detection` keeps in its folder while it runs, so that the same command goes on after a stop."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from gsrain_engine.evaluate.detection.detector import Detector
from gsrain_engine.evaluate.detection.finished import FINISHED_FILE, Finished
from gsrain_engine.scene.content_hash import file_hash

from ...console import print
from .detection_numbers import package_versions
from .detection_source import PreparedSource


def opened_memory(
    folder: Path,
    source: PreparedSource,
    detectors: Sequence[Detector],
    files: Sequence[Path],
    backend: str,
    is_wet: bool,
) -> Finished:
    """Open the judgements in a folder, and say how many of an earlier run still hold."""
    inputs = {
        "inputs": source.inputs,
        "wet": is_wet,
        "rain": msgspec.to_builtins(source.pictures.rain),
        "sky": msgspec.to_builtins(source.pictures.sky),
        "rain_before_pictures": source.pictures.is_in_front,
        "backend": backend,
        "versions": package_versions(),
    }
    used = {
        each.name: file_hash(file) + msgspec.json.encode(each.description, order="sorted").decode()
        for each, file in zip(detectors, files, strict=True)
    }
    memory = Finished(folder / FINISHED_FILE, inputs, used)
    kept = memory.read(source.frames)
    if kept:
        print(f"{folder / FINISHED_FILE}: {kept} pictures judged before")
    return memory
