"""gsrain_engine.api, which programs imported from before there was `gsrain`: its names, and what they cost."""

import ast
import subprocess
import sys

import pytest

from gsrain_engine import api
from repository import REPOSITORY


def test_type_checkers_see_the_very_names_that_there_are():
    source = ast.parse((REPOSITORY / "gsrain_engine" / "api.py").read_text(encoding="utf-8"))
    (block,) = [node for node in source.body if isinstance(node, ast.If)]
    seen = {alias.asname: each.module for each in block.body for alias in each.names if alias.name == alias.asname}
    there = {name: place for topic in api.TOPICS.values() for name, place in topic.items()}
    assert seen == there and sum(map(len, api.TOPICS.values())) == len(there) == len(dir(api))


def test_every_name_is_there():
    for name in dir(api):
        found = getattr(api, name)
        assert getattr(found, "__name__", name) == name
    for old, name in api._RENAMED.items():
        assert getattr(api, old) is getattr(api, name)
    with pytest.raises(AttributeError, match="gsrain_engine.api has no 'open_scenes'"):
        api.open_scenes  # noqa: B018


def test_importing_it_loads_nothing_that_is_not_asked_for():
    heavy = ["numba", "moderngl", "matplotlib", "scipy", "torch", "cv2", "xarray", "av", "imgui_bundle"]
    script = f"import sys, gsrain_engine.api as api; print(sorted(set(sys.modules) & {set(heavy)}), api.Gaussians)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("[] <class 'gsrain_engine.scene.gaussians.Gaussians'>")
