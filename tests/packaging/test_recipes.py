"""Conda recipe, container file and citation file agree with the project that they package."""

import re
import tomllib

import pytest
import yaml
from packaging.requirements import Requirement

from repository import REPOSITORY

CONDA_NAMES = {
    "glfw": "pyglfw", "lazy-loader": "lazy_loader", "matplotlib": "matplotlib-base",
    "opencv-contrib-python-headless": "py-opencv", "openexr": "openexr-python",
}  # fmt: skip


@pytest.fixture(scope="module")
def project():
    return tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]


def test_the_conda_recipe_has_the_requirements_of_the_project(project):
    recipe = yaml.safe_load((REPOSITORY / "packaging" / "conda" / "recipe.yaml").read_text("utf-8"))
    assert recipe["context"]["version"] == project["version"]
    asked = {}
    for each in map(Requirement, project["dependencies"]):
        asked[CONDA_NAMES.get(each.name.lower(), each.name.lower())] = str(each.specifier)
    asked["python"] = project["requires-python"]
    assert dict(map(str.split, recipe["requirements"]["run"])) == asked
    (entry,) = recipe["build"]["python"]["entry_points"]
    assert dict([entry.split(" = ")]) == project["scripts"]


def test_the_container_has_the_system_packages_that_the_page_names():
    container = (REPOSITORY / "packaging" / "Containerfile").read_text("utf-8")
    page = (REPOSITORY / "docs" / "installing.md").read_text("utf-8")
    (installed,), (named,) = (
        {frozenset(found.split()) for found in re.findall(r"--no-install-recommends ((?:[\w.-]+ ?)+)", text)}
        for text in (container, page)
    )
    assert installed == named - {"python3-venv"}
    extras = re.search(r"EXTRAS=(\S+)", container)[1].split(",")
    known = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    assert set(extras) <= set(known)


def test_the_citation_is_of_this_version(project):
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text("utf-8"))
    assert citation["version"] == project["version"] and citation["license"] == project["license"]
    changes = (REPOSITORY / "CHANGELOG.md").read_text("utf-8")
    assert f"## {citation['version']}" in changes and str(citation["date-released"]) in changes
