"""Files that GSRAIN writes are read by programs of others, and theirs by GSRAIN, with the same Gaussians."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom, UsdValidation
from scipy.spatial import cKDTree

from gsrain_engine.scene.formats.registry import read_gaussians, write_gaussians
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.geometry import matrices_from_quaternions, srgb_to_linear

from .sample_files import sample_gaussians
from .test_scene_folder import sample_scene


def covariances(gaussians: Gaussians) -> np.ndarray:
    axes = matrices_from_quaternions(gaussians.quaternions) * gaussians.scales[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def assert_close(found: Gaussians, expected: Gaussians, mean: float, covariance: float, color: float) -> None:
    """Assert that Gaussians in any order are the same, compared with their nearest ones."""
    distances, nearest = cKDTree(expected.means).query(found.means)
    expected = expected.take(nearest)
    assert distances.max() <= mean and len({*nearest.tolist()}) == len(expected)
    np.testing.assert_allclose(covariances(found), covariances(expected), atol=covariance)
    np.testing.assert_allclose(found.opacities, expected.opacities, atol=0.0021)
    k = min(found.sh.shape[1], expected.sh.shape[1])
    np.testing.assert_allclose(found.sh[:, :k], expected.sh[:, :k], atol=color)


# splat-transform (PlayCanvas): npm install --global @playcanvas/splat-transform, or its path in SPLAT_TRANSFORM

_SPLAT_TRANSFORM = os.environ.get("SPLAT_TRANSFORM") or shutil.which("splat-transform")
needs_splat_transform = pytest.mark.skipif(
    _SPLAT_TRANSFORM is None or shutil.which("node") is None, reason="splat-transform is not installed (npm)"
)
_BOUNDS = {
    ".ply": (0, 1e-6, 1e-6),
    ".compressed.ply": (0.03, 0.01, 0.02),
    ".splat": (1e-6, 0.02, 1 / 255 / SH_C0),
    ".spz": (1e-4, 0.04, 0.03),
    ".glb": (0, 1e-6, 1e-6),
}
"""Largest differences of means, covariances and harmonics."""


def transformed(source: Path, target: Path) -> Path:
    command = ["node", str(_SPLAT_TRANSFORM), "-q", "-w", "-g", "cpu", str(source), str(target)]
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    return target


@needs_splat_transform
@pytest.mark.parametrize("suffix", [".compressed.ply", ".splat", ".spz"])
def test_splat_transform_reads_what_is_written(suffix: str, tmp_path: Path) -> None:
    before = sample_gaussians(600, 3)
    write_gaussians(before, tmp_path / f"ours{suffix}")
    after = read_gaussians(transformed(tmp_path / f"ours{suffix}", tmp_path / "theirs.ply"))
    assert_close(after, before, *_BOUNDS[suffix])


@needs_splat_transform
def test_splat_transform_reads_a_sog_as_it_is_read_here(tmp_path: Path) -> None:
    write_gaussians(sample_gaussians(600, 3), tmp_path / "ours.sog")
    theirs = read_gaussians(transformed(tmp_path / "ours.sog", tmp_path / "theirs.ply"))
    assert_close(theirs, read_gaussians(tmp_path / "ours.sog"), 1e-5, 1e-5, 1e-5)


@needs_splat_transform
@pytest.mark.parametrize("suffix", [".compressed.ply", ".spz", ".glb"])
def test_files_of_splat_transform_are_read(suffix: str, tmp_path: Path) -> None:
    before = sample_gaussians(600, 3)
    write_gaussians(before, tmp_path / "ours.ply")
    after = read_gaussians(transformed(tmp_path / "ours.ply", tmp_path / f"theirs{suffix}"))
    # Their SPZ keeps 4 bits of harmonics from degree 2 on.
    assert_close(after, before, *(_BOUNDS[suffix] if suffix != ".spz" else (3e-4, 0.04, 0.07)))


# glTF and OpenUSD


def test_trimesh_reads_the_points_of_a_glb(tmp_path: Path) -> None:
    before = sample_gaussians(50, 2)
    write_gaussians(before, tmp_path / "a.glb")
    (cloud,) = trimesh.load(tmp_path / "a.glb").geometry.values()
    np.testing.assert_array_equal(cloud.vertices, before.means * np.float32([-1, -1, 1]))
    colors = srgb_to_linear((before.sh[:, 0] * SH_C0 + 0.5).clip(0, 1))
    np.testing.assert_allclose(cloud.colors[:, :3] / 255, colors, atol=0.51 / 255)
    np.testing.assert_allclose(cloud.colors[:, 3] / 255, before.opacities, atol=0.51 / 255)


def test_usd_itself_finds_layers_tracks_and_cameras(tmp_path: Path) -> None:
    scene = sample_scene()
    scene = scene.with_member("actors/lead/1", visible=True)
    write_scene(scene, tmp_path / "a.usdz")
    stage = Usd.Stage.Open(str(tmp_path / "a.usdz"))
    context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
    problems = [error for error in context.Validate(stage) if error.GetName() != "UnsupportedFileExtensionInPackage"]
    assert not problems  # but for NuRec's JSON and YAML files
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    (car,) = (actor for actor in scene.actors)
    prim = stage.GetPrimAtPath("/World/actors/lead_1/gaussians")
    assert prim.GetTypeName() == "ParticleField3DGaussianSplat"
    np.testing.assert_array_equal(np.array(prim.GetAttribute("positions").Get()), car.gaussians.means)
    for time_s in (0.0, 0.7, 1.4):
        cache = UsdGeom.XformCache(stage.GetTimeCodesPerSecond() * time_s)
        pose = car.pose_at(time_s)
        assert pose is not None
        np.testing.assert_allclose(
            np.array(cache.GetLocalToWorldTransform(prim)).T, scene.scene_to_world @ pose, atol=1e-9
        )
    lens = UsdGeom.Camera.Get(stage, "/World/ego/waymo/FRONT").GetCamera().frustum
    right = np.array(lens.ComputeProjectionMatrix())
    np.testing.assert_allclose([right[0, 0], right[1, 1]], [2 * 2059 / 1920, 2 * 2058.5 / 1280], rtol=1e-6)
    # The principal point is 3 px left of the middle.
    np.testing.assert_allclose(right[2, :2], [2 * 3 / 1920, 0], atol=1e-6)


def test_a_scene_comes_back_from_usdz(tmp_path: Path) -> None:
    before = sample_scene().with_member("actors/lead/1", visible=True).with_member("layers/sky", visible=True)
    for path in (tmp_path / "a.usdz", tmp_path / "b.usdz"):
        write_scene(before, path)
    assert (tmp_path / "a.usdz").read_bytes() == (tmp_path / "b.usdz").read_bytes()
    after = read_scene(tmp_path / "a.usdz")
    assert [(layer.name, layer.kind) for layer in after.layers] == [("road & kerb", "background"), ("sky", "sky")]
    assert [actor.id for actor in after.actors] == ["lead/1"] and after.metres_per_unit == 1
    for time_s in (0.0, 0.7, 2.0):
        for was, found in zip(before.parts(time_s), after.parts(time_s), strict=True):
            np.testing.assert_allclose(found.to_world @ np.diag([1, 1, 1, 1.0]), found.to_world)
            middles = [part.remaining.means @ part.to_world[:3, :3].T + part.to_world[:3, 3] for part in (was, found)]
            np.testing.assert_allclose(middles[1], middles[0], rtol=1e-5, atol=1e-5)
        for now in (before, after):
            assert now.ego_to_world(time_s) is not None
        np.testing.assert_allclose(after.ego_to_world(time_s), before.ego_to_world(time_s), atol=1e-9)
    for was, found in zip(before.rigs["waymo"], after.rigs["waymo"], strict=True):
        np.testing.assert_allclose(found.camera_to_ego, was.camera_to_ego, atol=1e-9)
        assert (found.name, found.width, found.fx, found.exposure_s) == (was.name, was.width, was.fx, was.exposure_s)
