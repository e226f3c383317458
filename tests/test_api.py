"""gsrain_engine.api: its names, what they cost, and the page about them."""

import ast
import importlib.util
import subprocess
import sys

import pytest
from PIL import Image

from extension_package import titled_blocks
from gsrain_engine import api
from gsrain_engine.scene.formats import write_scene
from repository import REPOSITORY
from small_scene import small_scene


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
    with pytest.raises(AttributeError, match="gsrain_engine.api has no 'open_scenes'"):
        api.open_scenes  # noqa: B018


def test_importing_it_loads_nothing_that_is_not_asked_for():
    heavy = ["numba", "moderngl", "matplotlib", "scipy", "torch", "cv2", "xarray", "av", "imgui_bundle"]
    script = f"import sys, gsrain_engine.api as api; print(sorted(set(sys.modules) & {set(heavy)}), api.Gaussians)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("[] <class 'gsrain_engine.scene.gaussians.Gaussians'>")


def test_the_page_says_what_the_docstrings_say():
    spec = importlib.util.spec_from_file_location("api_page", REPOSITORY / "docs" / "api_page.py")
    page = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(page)
    assert page.written_tables() == page.tables(), "python -m docs.api_page writes it anew"
    assert "|  |" not in page.tables()


def test_the_program_of_the_page_draws_a_picture(tmp_path, monkeypatch):
    write_scene(small_scene(), tmp_path / "street")
    monkeypatch.chdir(tmp_path)
    exec(compile(titled_blocks(REPOSITORY / "docs" / "python.md")["rain.py"], "rain.py", "exec"), {})
    with Image.open("rain.png") as picture:
        assert picture.size == (960, 640) and len(picture.getcolors(2**20) or []) > 100
