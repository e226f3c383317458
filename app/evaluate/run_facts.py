"""Provenance of an evaluation's numbers: command line, versions, and hashes of the inputs."""

import hashlib
import shlex
import sys
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from ..options import write_numbers

_DIGITS = 16


def run_provenance(inputs: Mapping[str, str], packages: Iterable[str] = ()) -> dict[str, Any]:
    """Return the provenance for a file of numbers: `inputs` are hashes by name, `packages` the relevant ones."""
    versions = {name: version_of(name) for name in ("gsrain", "numpy", *packages)}
    return {"command": shlex.join(["gsrain", *sys.argv[1:]]), "versions": versions, "inputs": dict(inputs)}


def provenance_lines(facts: Mapping[str, Any]) -> dict[str, str]:
    """Return the provenance as lines by title."""
    versions = ", ".join(f"{name} {version}" for name, version in facts["versions"].items() if version is not None)
    hashes = {f"hash of {name}": str(value) for name, value in facts["inputs"].items()}
    return {"command": str(facts["command"]), "versions": versions, **hashes}


def version_of(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def set_hash(hashes: Iterable[str]) -> str:
    """Return one hash (16 hex digits) of a set of images from the hashes of its images, in order."""
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest()[:_DIGITS]


def write_report_numbers(report: Path | None, asked: Path | None, numbers: Mapping[str, Any]) -> Path | None:
    """Write numbers as JSON next to a report, unless another file was chosen for them; returns the file."""
    if report is None or asked is not None:
        return None
    file = report.with_suffix(".json")
    write_numbers(file, numbers)
    return file
