"""Licenses of dependencies are compatible with Apache-2.0, and the page of licenses lists them."""

import sys
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def licences():
    sys.path.insert(0, str(REPOSITORY / "packaging"))
    import licences

    sys.path.pop(0)
    return licences


def test_no_dependency_is_under_the_gpl_or_silent(licences):
    packages = set().union(*(licences.needed(extra)[0] for extra in ["", *licences.extras()]))
    found = {name: licences.licence_of(metadata.distribution(name)) for name in packages}
    assert {"numpy", "imgui-bundle", "hypothesis"} <= set(found)
    assert {name: each for name, each in found.items() if not licences.is_allowed(each)} == {}


@pytest.mark.parametrize(
    ("expression", "allowed"),
    [
        ("AGPL-3.0-only", False),
        ("LGPL-2.1-only AND MPL-2.0", True),
        ("MIT AND GPL-2.0-only", False),
        ("MIT OR GPL-2.0-only", True),
        ("GPL-3.0-only WITH GCC-exception-3.1 AND MIT", True),
        ("(GPL-2.0-only OR AGPL-3.0-only) AND MIT", False),
        ("(GPL-2.0-only OR FTL) AND MIT", True),
        ("unknown", False),
    ],
)
def test_what_is_allowed(licences, expression, allowed):
    assert licences.is_allowed(expression) is allowed


@pytest.mark.parametrize(
    ("header", "text", "licence"),
    [
        ("License-Expression: mit", "", "MIT"),
        ("License: 3-Clause BSD License", "", "BSD-3-Clause"),
        ("Classifier: License :: OSI Approved :: GNU General Public License v3 (GPLv3)", "", "GPL-3.0-only"),
        ("License: BSD", "Redistribution and use in source and binary forms\nNeither the name of", "BSD-3-Clause"),
        ("License: BSD", "Redistribution and use in source and binary forms", "BSD-2-Clause"),
        ("License: see the lawyer", "All rights reserved.", "unknown"),
        ("License: NVIDIA Proprietary Software", "", "LicenseRef-NVIDIA-Proprietary"),
        ("Summary: silent", "Permission is hereby granted, free of charge, to any person obtaining a copy", "MIT"),
    ],
)
def test_licences_are_read_from_what_packages_say(licences, tmp_path, header, text, licence):
    folder = tmp_path / "thing-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text(f"Metadata-Version: 2.4\nName: thing\nVersion: 1.0\n{header}\n")
    (folder / "LICENSE.txt").write_text(text)
    (folder / "RECORD").write_text("thing-1.0.dist-info/METADATA,,\nthing-1.0.dist-info/LICENSE.txt,,\n")
    assert licences.licence_of(metadata.Distribution.at(folder)) == licence


def test_builds_for_gpus_bring_packages_without_a_license(licences, tmp_path):
    (tmp_path / "METADATA").write_text("Metadata-Version: 2.4\nName: cuda-toolkit\nVersion: 13.0\n")
    assert licences.licence_of(metadata.Distribution.at(tmp_path)) == "LicenseRef-NVIDIA-Proprietary"


def test_the_page_names_every_direct_dependency(licences):
    page = (REPOSITORY / "THIRD_PARTY_LICENCES.md").read_text("utf-8")
    named = {canonicalize_name(row.split("|")[1].strip()) for row in page.splitlines() if row.startswith("| ")}
    named |= {canonicalize_name(name) for name in page.rpartition("was written:")[2].strip(" .\n").split(", ")}
    project = licences.project()
    shipped = (
        each for name, each in project["optional-dependencies"].items() if name not in ("dev", "docs", "oracles")
    )
    asked = [*project["dependencies"], *(each for extra in shipped for each in extra)]
    missing = {canonicalize_name(Requirement(each).name) for each in asked} - named - {"gsrain"}
    assert not missing, "make licences writes the page anew"
