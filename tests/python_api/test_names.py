"""`import gsrain as gr`: its names, what importing it loads, and the page about them."""

import ast
import inspect
import subprocess
import sys

import pytest
from PIL import Image

import gsrain as gr
from docs import api_page
from extension_package import titled_blocks
from gsrain_engine.scene.formats.scene_files import write_scene
from repository import REPOSITORY
from small_scene import small_scene

STUB = REPOSITORY / "gsrain" / "__init__.pyi"
HEAVY = ["numba", "numpy", "scipy", "torch", "imgui_bundle", "glfw", "moderngl", "cv2", "av", "matplotlib", "msgspec"]


def test_importing_it_loads_nothing_heavy_and_no_name_loads_torch_or_a_window():
    loaded = f"print(sorted(set(sys.modules) & {set(HEAVY)}))"
    script = f"import sys, gsrain as gr; {loaded}; [getattr(gr, name) for name in dir(gr)]; {loaded}"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    imported, used = map(ast.literal_eval, done.stdout.splitlines())
    assert imported == [] and not {"torch", "imgui_bundle", "glfw"} & set(used)


def test_every_name_of_the_stub_is_there_and_documented():
    names = [each.name for node in ast.parse(STUB.read_text()).body for each in node.names]
    assert sorted(names) == sorted(gr.__all__) == dir(gr) and 30 <= len(names) <= 62
    for name in names:
        assert inspect.getdoc(getattr(gr, name)), name
    with pytest.raises(AttributeError, match="gsrain"):
        gr.open_scene  # noqa: B018


def test_the_page_has_the_text_of_the_docstrings():
    tables = api_page.tables()
    assert "|  |" not in tables
    assert all(f"`{name}" in tables for name in gr.__all__)


def test_the_first_program_of_the_page_makes_an_image(tmp_path, monkeypatch):
    write_scene(small_scene(), tmp_path / "street")
    monkeypatch.chdir(tmp_path)
    exec(compile(titled_blocks(REPOSITORY / "docs" / "python.md")["rain.py"], "rain.py", "exec"), {})
    with Image.open("rain.png") as picture:
        assert picture.size == (960, 640) and len(picture.getcolors(2**20) or []) > 100
