"""Scenes of OpenUSD: read back, read by OpenUSD itself, damaged, without memory, disk or package."""

import io
import json
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.main import BAD_INPUT, run
from grpc_clients import scene_with_car
from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats.registry import lost_in_file, read_gaussians
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_extras.usd.nurec import nurec_files
from reliability.commands import leftovers
from reliability.test_full_disk import files_of_at_most
from small_scene import small_scene
from tests.scene.formats.sample_files import sample_gaussians, written
from tests.scene.formats.test_scene_folder import sample_scene

pytest.importorskip("pxr")


def test_usd_itself_finds_layers_tracks_and_cameras(tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom, UsdValidation

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
    camera = UsdGeom.Camera.Get(stage, "/World/ego/waymo/FRONT").GetCamera()
    film_m, focal_m = camera.horizontalAperture * camera.APERTURE_UNIT, camera.focalLength * camera.FOCAL_LENGTH_UNIT
    np.testing.assert_allclose([film_m, focal_m], [0.036, 0.036 * 2059 / 1920], rtol=1e-6)
    right = np.array(camera.frustum.ComputeProjectionMatrix())
    np.testing.assert_allclose([right[0, 0], right[1, 1]], [2 * 2059 / 1920, 2 * 2058.5 / 1280], rtol=1e-6)
    # The principal point is 3 px left of the middle.
    np.testing.assert_allclose(right[2, :2], [2 * 3 / 1920, 0], atol=1e-6)


def test_a_scene_comes_back_from_usdz(tmp_path: Path) -> None:
    before = sample_scene().with_member("actors/lead/1", visible=True).with_member("layers/sky", visible=True)
    for path in (tmp_path / "a.usdz", tmp_path / "b.usdz"):
        write_scene(before, path)
    assert (tmp_path / "a.usdz").read_bytes() == (tmp_path / "b.usdz").read_bytes()
    after = read_scene((tmp_path / "a.usdz").rename(tmp_path / "last.usdz"))
    assert after.name == before.name  # by which AlpaSim asks for it, whatever its file's name
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


def test_files_tell_antialiased_gaussians_from_others(tmp_path: Path) -> None:
    for antialiased in (True, False):
        before = replace(sample_gaussians(50, 1), antialiased=antialiased)
        (tmp_path / "a.usdz").write_bytes(written(before, ".usdz"))
        assert read_gaussians(tmp_path / "a.usdz").antialiased is antialiased
        assert read_scene(tmp_path / "a.usdz").layers[0].gaussians.antialiased is antialiased


def test_a_place_far_out_comes_back(tmp_path: Path) -> None:
    scene = replace(small_scene(), origin=(447_613.0, 5_411_938.0, 212.0))
    write_scene(scene, tmp_path / "a.usdz")
    back = read_scene(tmp_path / "a.usdz")
    for was, found in zip(scene.layers, back.layers, strict=True):
        to_world = back.scene_to_world @ found.to_scene
        places = found.gaussians.means @ to_world[:3, :3].T + to_world[:3, 3]
        places = places + back.scene_to_world[:3, :3] @ back.origin
        np.testing.assert_allclose(places, was.gaussians.means + np.array(scene.origin), atol=1e-4, rtol=0)
    assert not lost_in_file(scene, tmp_path / "a.usdz")


def test_files_for_alpasim_describe_the_drive() -> None:
    (drive,) = json.loads(nurec_files(scene_with_car())["rig_trajectories.json"])["rig_trajectories"]
    assert drive["rig_bbox"]["dim"] == [4.6, 1.85, 1.5]  # without a box AlpaSim rejects the scene
    assert drive["cameras_frame_timestamps_us"]["FRONT@gsrain"][0][0] == 1_000_000  # after a shutter could open


# Damage


def usdz(*members: tuple[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in members:
            archive.writestr(name, content)
    return file.getvalue()


_STAGE = b"""#usda 1.0
def ParticleField3DGaussianSplat "a"
{
    point3f[] positions = [(0, 0, %s)]
    %s
}"""


@pytest.mark.parametrize(
    ("data", "field"),
    [
        (b"", "zip"),
        (usdz(("metadata.yaml", b"{}")), "no USD layer"),
        (usdz(("../a.usda", b"#usda 1.0")), "no name of a file inside"),
        (usdz(("a.usda", b"#usda 1.0\n(((")), "its USD layer is damaged"),
        (usdz(("a.usda", _STAGE % (b"nan", b""))), "1 of 1 Gaussians have a mean"),
        (usdz(("a.usda", _STAGE % (b"0", b"float[] opacities = [2]"))), "an opacity outside 0 to 1"),
    ],
)
def test_what_is_wrong_is_named(data: bytes, field: str, tmp_path: Path) -> None:
    file = tmp_path / "a.usdz"
    file.write_bytes(data)
    with pytest.raises(SceneFormatError, match=f"^{re.escape(str(file))}: .*{field}"):
        read_gaussians(file)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of other systems differ")
@pytest.mark.parametrize(("limit", "is_read"), [(12 << 30, True), (400 << 20, False)])
def test_a_limit_of_the_address_space_is_no_damage(
    limit: int, is_read: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hard limit, as `ulimit -v` sets it, which no process may raise."""
    import resource

    (tmp_path / "a.usdz").write_bytes(usdz(("a.usda", _STAGE % (b"0", b""))))
    run = subprocess.run

    def limited(command: list[str], **options: Any) -> "subprocess.CompletedProcess[bytes]":
        return run(command, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)), **options)

    monkeypatch.setattr(subprocess, "run", limited)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (limit, limit))
    if is_read:
        assert len(read_gaussians(tmp_path / "a.usdz")) == 1
    else:
        with pytest.raises(SceneFormatError, match=r"a\.usdz: .*400 MiB \(ulimit -v\)"):
            read_gaussians(tmp_path / "a.usdz")


def test_a_full_disk_leaves_the_older_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_scene(small_scene(), tmp_path / "scene")
    (tmp_path / "a.usdz").write_bytes(b"older")
    with files_of_at_most(2000):
        assert run(["convert", str(tmp_path / "scene"), str(tmp_path / "a.usdz")]) == BAD_INPUT
    assert capsys.readouterr().err == f"gsrain: {tmp_path / 'a.usdz'}: File too large\n"
    assert (tmp_path / "a.usdz").read_bytes() == b"older" and not leftovers(tmp_path)


def test_without_its_package_a_file_is_named_with_the_line_that_installs_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_scene(small_scene(), tmp_path / "scene")
    write_scene(small_scene(), tmp_path / "a.usdz")
    monkeypatch.setitem(sys.modules, "pxr", None)
    for words in (["info", f"{tmp_path / 'a.usdz'}"], ["convert", f"{tmp_path / 'scene'}", f"{tmp_path / 'b.usdz'}"]):
        assert run(words) == BAD_INPUT
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"gsrain: {words[-1]}: a .usdz file needs usd-core, which is not installed: ")
        assert line.endswith("-m pip install 'gsrain[usd]'")
    run(["doctor"])
    assert re.search(r"^absent  scene format usdz: .* needs usd-core, ", capsys.readouterr().out, re.MULTILINE)
