"""Numbers of a run as JSON, and their provenance: command line, versions, and hashes of the inputs."""

import hashlib
import json
import math
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import lazy_loader

from ..safe_io.files import whole_file

if TYPE_CHECKING:
    import msgspec
else:
    msgspec = lazy_loader.load("msgspec")  # every command imports this module


def finite_numbers(value: Any) -> Any:
    """Replace NaN and infinity, which JSON lacks, with null."""
    if isinstance(value, dict):
        return {name: finite_numbers(each) for name, each in cast(dict[str, Any], value).items()}
    if isinstance(value, list | tuple):
        return [finite_numbers(each) for each in cast(Sequence[Any], value)]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_text(file: Path, text: str) -> None:
    """Write a text file as a whole; missing folders are made."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(file) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(file: Path, numbers: Mapping[str, Any]) -> None:
    """Write numbers as JSON; missing folders are made."""
    write_text(file, json.dumps(numbers, indent=1) + "\n")


# Provenance


def run_provenance(inputs: Mapping[str, str], packages: Iterable[str] = ()) -> dict[str, Any]:
    """Return the provenance for a file of numbers: `inputs` are hashes by name, `packages` the relevant ones."""
    versions = {name: version_of(name) for name in ("gsrain", "numpy", *packages)}
    return {"command": command_line(), "versions": versions, "inputs": dict(inputs)}


def provenance_file(output: Path) -> Path:
    """Return the file beside an output, a file or a folder, that holds its provenance."""
    return output.with_suffix(".provenance.json") if output.suffix else Path(f"{output}.provenance.json")


def write_provenance(
    output: Path,
    pictures: "Mapping[str, msgspec.Struct]",
    file: Path | None = None,
    more: "Mapping[str, Any] | None" = None,
) -> dict[str, Any]:
    """Write what the pictures of an output hold, by name, beside it or to a file; returns it for other files."""
    held = {name: msgspec.to_builtins(each) for name, each in pictures.items()}
    facts = {**run_provenance({}), **(more or {}), "pictures": held}
    write_json(file or provenance_file(output), facts)
    return {"provenance": facts}


def provenance_lines(facts: Mapping[str, Any]) -> dict[str, str]:
    """Return the provenance as lines by title."""
    versions = ", ".join(f"{name} {version}" for name, version in facts["versions"].items() if version is not None)
    hashes = {f"hash of {name}": str(value) for name, value in facts["inputs"].items()}
    return {"command": str(facts["command"]), "versions": versions, **hashes}


def command_line() -> str:
    """Return the command line of this process, of which the first word is gsrain or a program in Python."""
    program = Path(sys.argv[0]).name
    return shlex.join([program if program.endswith(".py") and program != "__main__.py" else "gsrain", *sys.argv[1:]])


def version_of(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


# Hashes of inputs


def set_hash(hashes: Iterable[str]) -> str:
    """Return one hash (16 hex digits) of a set of images from the hashes of its images, in order."""
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest()[:16]
