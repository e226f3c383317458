"""Damaged files that a reader once did not come to terms with: kept small, as text, and tried in every test run."""

import base64
import json
import re
import zlib
from pathlib import Path

from .reader import Finding

FOUND = Path(__file__).parent / "found"
EXTRAS = Path(__file__).parents[1] / "extras"
"""Tests of the folders of `gsrain_extras`, each with `found` of its own."""


def findings() -> list[Path]:
    """Return the files of all findings."""
    return sorted([*FOUND.glob("*.json"), *EXTRAS.glob("*/found/*.json")])


def write_finding(finding: Finding, folder: Path) -> Path:
    """Write a finding as a file of its own, named after its reader and what was wrong; one that is there stays."""
    folder.mkdir(parents=True, exist_ok=True)
    sign = zlib.crc32(kind_of(finding).encode())
    file = folder / f"{finding.reader}-{sign:08x}.json"
    if not file.exists():
        packed = base64.b64encode(zlib.compress(finding.content, 9)).decode()
        row = {"reader": finding.reader, "file": finding.file, "what": _words(finding), "content_zlib_base64": packed}
        file.write_text(json.dumps(row, indent=1) + "\n")
    return file


def read_finding(file: Path) -> Finding:
    """Read what `write_finding` has written."""
    row = json.loads(file.read_text())
    content = zlib.decompress(base64.b64decode(row["content_zlib_base64"]))
    return Finding(row["reader"], row["file"], content, row["what"])


def kind_of(finding: Finding) -> str:
    """The problem without numbers and names, which differ from file to file."""
    return re.sub(r"'[^']*'|\"[^\"]*\"|/\S+|[-+]?\d[\d.e+-]*", "_", f"{finding.file} {finding.what}"[:160])


def _words(finding: Finding) -> str:
    """The problem without the folder of the trial."""
    return re.sub(r"/\S+/", "", finding.what)
