"""A driver that has OpenGL 4.1 only, as macOS has: the window opens, and shows and warps the processor's pictures."""

import json
import os
import subprocess
import sys
from pathlib import Path

import glfw
import numpy as np
import pytest
from PIL import Image

import window_driver  # noqa: F401  skips where there is no display
from app.main import BAD_INPUT, run

SCRIPT = Path(__file__).resolve().parent.parent / "old_window.py"
LATER_EXTENSIONS = (
    "ARB_clear_texture", "ARB_compute_shader", "ARB_copy_image", "ARB_explicit_uniform_location",
    "ARB_multi_draw_indirect", "ARB_shader_image_load_store", "ARB_shader_storage_buffer_object",
    "ARB_shading_language_420pack", "ARB_texture_view",
)  # fmt: skip
OLD = {
    "MESA_GL_VERSION_OVERRIDE": "4.1",
    "MESA_GLSL_VERSION_OVERRIDE": "410",
    "MESA_EXTENSION_OVERRIDE": " ".join(f"-GL_{each}" for each in LATER_EXTENSIONS),
}
"""Environment in which Mesa refuses what is newer than OpenGL 4.1."""


def run_old(*command, folder):
    paths = os.pathsep.join([str(SCRIPT.parent), str(SCRIPT.parent.parent)])
    own = {f"XDG_{each}_HOME": str(folder / each.lower()) for each in ("CONFIG", "STATE")}
    return subprocess.run(
        [sys.executable, *map(str, command)],
        env=os.environ | OLD | own | {"PYTHONPATH": os.pathsep.join([paths, os.environ.get("PYTHONPATH", "")])},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _limited(tmp_path_factory):
    glfw.init()  # a client of the X server that stays: it starts over when its last one leaves
    asking = "from ui.window import window_version; print(window_version())"
    version = run_old("-c", asking, folder=tmp_path_factory.mktemp("asked")).stdout.split()[-1:]
    if version != ["410"]:
        pytest.skip(f"only Mesa's version can be limited: {version}")


def test_the_window_shows_and_warps_what_the_processor_draws(tmp_path):
    done = run_old(SCRIPT, tmp_path, folder=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert (found["version"], found["back_end"], found["problem"]) == (410, "cpu", None)
    assert found["error"] == "GL_NO_ERROR"
    assert found["reason"].startswith("OpenGL 4.1 has no compute shaders")
    assert found["colors_on_screen"] > 1000 and found["pixels_of_points"] > 100
    assert found["warped"] and found["warped"] == pytest.approx([found["mean"]] * len(found["warped"]), rel=0.2)
    (shot,) = (tmp_path / "shots").iterdir()
    exact = tmp_path / "exact.png"
    options = ("--camera", tmp_path / "camera.json", "--time", found["time_s"], "--rain", found["intensity_mm_h"])
    assert run(["render", *map(str, (tmp_path / "scene", *options, "--backend", "cpu", "-o", exact))]) == 0
    difference = np.abs(np.asarray(Image.open(shot)).astype(int) - np.asarray(Image.open(exact)))
    assert difference.max() <= 1


def test_its_back_ends_are_refused_by_one_sentence_and_doctor_names_its_version(tmp_path):
    done = run_old("-m", "app", "--backend", "opengl-quads", folder=tmp_path)
    assert done.returncode == BAD_INPUT
    (sentence,) = [line for line in done.stderr.splitlines() if line.startswith("gsrain: ")]
    assert sentence.startswith("gsrain: OpenGL 4.1 has no compute shaders") and "Traceback" not in done.stderr
    lines = run_old("-m", "app", "doctor", folder=tmp_path).stdout.splitlines()
    (opengl,) = [line for line in lines if "OpenGL without a window" in line]
    assert opengl.startswith("ok ") and opengl.endswith(", OpenGL 4.1 (software): the processor draws")
    assert "ok      display: the window can open, by OpenGL 4.1: the processor draws" in lines
    assert any(line.startswith("ok      fastest back end (--backend auto): cpu: OpenGL 4.1 has no") for line in lines)
