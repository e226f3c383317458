"""What the packages that GSRAIN needs are licensed under, from what is installed: writes THIRD_PARTY_LICENCES.md."""

import re
import sys
import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROGRAM = "gsrain"
REPOSITORY = Path(__file__).resolve().parents[1]
UNKNOWN = "unknown"
_NAMES = {
    "apache": "Apache-2.0",
    "apache 2.0": "Apache-2.0",
    "apache 2.0 license": "Apache-2.0",
    "apache license": "Apache-2.0",
    "apache software license": "Apache-2.0",
    "bsd 2-clause license": "BSD-2-Clause",
    "freebsd": "BSD-2-Clause",
    "bsd 3-clause license": "BSD-3-Clause",
    "3-clause bsd license": "BSD-3-Clause",
    "isc license": "ISC",
    "isc license (iscl)": "ISC",
    "mit license": "MIT",
    "the mit license (mit)": "MIT",
    "mozilla public license version 2.0": "MPL-2.0",
    "mozilla public license 2.0 (mpl 2.0)": "MPL-2.0",
    "python software foundation license": "PSF-2.0",
    "gnu general public license v2 (gplv2)": "GPL-2.0-only",
    "gnu general public license v2 or later (gplv2+)": "GPL-2.0-or-later",
    "gnu general public license v3 (gplv3)": "GPL-3.0-only",
    "gnu general public license v3 or later (gplv3+)": "GPL-3.0-or-later",
    "gnu affero general public license v3": "AGPL-3.0-only",
    "gnu affero general public license v3 or later (agplv3+)": "AGPL-3.0-or-later",
    "nvidia proprietary software": "LicenseRef-NVIDIA-Proprietary",
}
"""SPDX identifiers by how packages write licences down, in lower case; for others their text is read."""
_SILENT = {"cuda-toolkit": "LicenseRef-NVIDIA-Proprietary"}
"""Licenses of packages that declare none and have no text: NVIDIA's, which only builds of torch for its GPUs need."""
_TEXTS = {
    "MIT": r"Permission is hereby granted, free of charge, to any person obtaining a copy",
    "Apache-2.0": r"Apache License\s+Version 2\.0",
    "BSD-3-Clause": r"Redistribution and use in source and binary forms.*(Neither the names? |not be used to endorse)",
    "BSD-2-Clause": r"Redistribution and use in source and binary forms",
}


def needed(extra: str = "") -> tuple[set[str], set[str]]:
    """Names of all packages that the program with an extra needs on this machine: those installed, and the others."""
    found: set[str] = set()
    absent: set[str] = set()
    seen: set[tuple[str, str]] = set()
    left = [(PROGRAM, ""), (PROGRAM, extra)]
    while left:
        package, wanted = left.pop()
        if (package, wanted) in seen:
            continue
        seen.add((package, wanted))
        try:
            requirements = _requirements(package, wanted)
        except metadata.PackageNotFoundError:
            absent.add(package)
            continue
        found.add(package)
        left += [(canonicalize_name(each.name), inner) for each in requirements for inner in ("", *each.extras)]
    return found - {PROGRAM}, absent


def _requirements(package: str, extra: str) -> list[Requirement]:
    """What a package asks for by itself, or for one of its extras. Our own wishes are read where they are written."""
    if package == PROGRAM:
        words = project()["optional-dependencies"][extra] if extra else project()["dependencies"]
        return [Requirement(each) for each in words]
    asked = map(Requirement, metadata.requires(package) or [])
    return [each for each in asked if each.marker is None or each.marker.evaluate({"extra": extra})]


def project() -> dict[str, Any]:
    return tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]


def extras() -> list[str]:
    """The extras of the program."""
    return list(project()["optional-dependencies"])


def licence_of(package: metadata.Distribution) -> str:
    """The SPDX expression of a package's licence, as it says itself; `UNKNOWN` where that can't be told."""
    declared = (package.metadata.get("License-Expression"), package.metadata.get("License"))
    classified = [
        each.split(" :: ")[-1] for each in package.metadata.get_all("Classifier") or [] if each.startswith("License ::")
    ]
    for each in [*declared, *classified]:
        if each and (known := _spdx(each)):
            return known
    is_bsd = any("BSD" in (each or "")[:20] for each in [*declared, *classified])  # and which of them, the text says
    patterns = {name: each for name, each in _TEXTS.items() if not is_bsd or name.startswith("BSD")}
    for text in texts_of(package):
        for name, pattern in patterns.items():
            if re.search(pattern, text, re.DOTALL):
                return name
    return "LicenseRef-BSD" if is_bsd else _SILENT.get(canonicalize_name(package.name), UNKNOWN)


def _spdx(words: str) -> str | None:
    try:
        return canonicalize_license_expression(words)
    except InvalidLicenseExpression:
        return _NAMES.get(words.strip().lower())


def texts_of(package: metadata.Distribution) -> Iterator[str]:
    """The licence files that a package brings along."""
    for file in package.files or []:
        if ".dist-info" in str(file) and re.match(r"(licen[cs]e|copying|notice)", file.name, re.IGNORECASE):
            yield Path(str(file.locate())).read_text("utf-8", errors="replace")


def is_allowed(expression: str) -> bool:
    """Whether a program under Apache-2.0 may need it: not unknown, no GPL or AGPL without a choice or exception.

    The LGPL and the MPL are no hindrance: what is under them stays in files of its own, which can be exchanged.
    """
    tokens = re.findall(r"\(|\)|[^\s()]+", expression)

    def alternatives() -> bool:
        allowed = together()
        while tokens and tokens[0] == "OR":
            tokens.pop(0)
            allowed = together() or allowed
        return allowed

    def together() -> bool:
        allowed = one()
        while tokens and tokens[0] == "AND":
            tokens.pop(0)
            allowed = one() and allowed
        return allowed

    def one() -> bool:
        first = tokens.pop(0)
        if first == "(":
            allowed = alternatives()
            tokens.pop(0)
            return allowed
        if tokens and tokens[0] == "WITH":
            del tokens[:2]
            return True
        return first != UNKNOWN and not re.match(r"A?GPL-", first)

    return alternatives()


def page() -> str:
    """The whole of THIRD_PARTY_LICENCES.md."""
    base, absent = needed()
    by = {name: ["the program"] for name in base}
    for extra in extras():
        installed, missing = needed(extra)
        absent |= missing
        for name in installed - base:
            by.setdefault(name, []).append(extra)
    rows = []
    for name in sorted(by):
        package = metadata.distribution(name)
        users = ", ".join(each for each in by[name] if each != "all")
        rows.append(f"| {package.name} | {package.version.split('+')[0]} | {licence_of(package)} | {users} |")
    head = (Path(__file__).parent / "inside_wheels.md").read_text("utf-8")
    missing_line = f"Not installed where this was written: {', '.join(sorted(absent))}.\n" if absent else ""
    return "\n".join(
        [head, "| package | version | licence | needed by |", "|---|---|---|---|", *rows, "", missing_line]
    )


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), "utf-8")
