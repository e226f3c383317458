import pickle
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.raster.rasterizer import rasterize
from gsrain_engine.reconstruct.recoloring.preview_cameras import PreviewCamera, preview_cameras
from gsrain_engine.reconstruct.recoloring.rainy_preview import rainy_preview
from gsrain_engine.reconstruct.recoloring.recolored_file import read_recolored, write_recolored
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.errors import SceneFormatError
from gsrain_engine.scene.gaussians import SH_C0
from gsrain_engine.scene.grading import Grading
from gsrain_engine.scene.marks import Marks
from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.jobs.rainy_look import with_colors

from .small_street import small_street


def small_views(scene: Scene, count: int = 4) -> list[PreviewCamera]:
    return [PreviewCamera(view.camera.resized(96, 64), view.time_s) for view in preview_cameras(scene, count)]


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> tuple[Scene, list[Progress], Path]:
    scene, path = small_street(), tmp_path_factory.mktemp("preview") / "wet.npz"
    return scene, list(rainy_preview(scene, small_views(scene), path)), path


def recolored(scene: Scene, path: Path) -> Scene:
    colors = read_recolored(path)
    return replace(
        scene,
        layers=tuple(
            replace(each, gaussians=each.gaussians.with_sh(colors[f"layers/{each.name}"])) for each in scene.layers
        ),
        actors=tuple(
            replace(each, gaussians=each.gaussians.with_sh(colors[f"actors/{each.id}"])) for each in scene.actors
        ),
    )


@cache
def new_camera() -> Camera:
    eye = np.array([3.2, -1.0, 1.7])
    return Camera.from_fov(96, 64, 60, look_at(eye, eye + np.array([1, 0.1, -0.08]), np.array([0.0, 0, 1])))


def test_progress_rises_to_the_end(finished):
    _, steps, _ = finished
    fractions = [step.fraction for step in steps]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0, 1)
    assert len(steps) > 4 + 12
    assert all(step.message for step in steps)


def test_every_layer_and_actor_gets_colors_of_its_own_shape(finished):
    scene, _, path = finished
    colors = read_recolored(path)
    shapes = {f"layers/{each.name}": each.gaussians.sh.shape for each in scene.layers}
    shapes |= {f"actors/{each.id}": each.gaussians.sh.shape for each in scene.actors}
    assert {name: sh.shape for name, sh in colors.items()} == shapes
    assert all(np.isfinite(sh).all() for sh in colors.values())


def test_a_view_that_was_not_used_looks_rainy_too(finished):
    scene, _, path = finished
    camera = new_camera()
    clear, wet = (rasterize(each.parts(0.0), camera).over() for each in (scene, recolored(scene, path)))
    sky, road = (slice(2, 12), slice(30, 66)), (slice(54, 63), slice(20, 76))
    blueness = [float((image[sky][..., 2] - image[sky][..., 0]).mean()) for image in (clear, wet)]
    assert blueness[0] > 0.4
    assert blueness[1] < 0.15
    assert wet[road].mean() < 0.85 * clear[road].mean()
    warmth = [float((image[..., 0] - image[..., 2])[30:44, :20].mean()) for image in (clear, wet)]
    assert warmth[1] < 0.8 * warmth[0]


def test_gaussians_that_no_view_sees_are_as_grey_as_their_neighbours(finished):
    scene, _, path = finished
    colors = read_recolored(path)
    mean = {name: 0.5 + SH_C0 * sh[:, 0].mean(axis=0) for name, sh in colors.items()}
    is_road = scene.layers[0].gaussians.means[:, 2] < 0.01
    is_near = is_road & (np.abs(scene.layers[0].gaussians.means[:, 0] - 12) < 8)
    seen = 0.5 + SH_C0 * colors["layers/street"][is_near, 0].mean(axis=0)
    is_unseen = is_road & (scene.layers[0].gaussians.means[:, 0] < -40)
    unseen = 0.5 + SH_C0 * colors["layers/street"][is_unseen, 0].mean(axis=0)
    assert seen.mean() < 0.45  # it was 0.52
    np.testing.assert_allclose(unseen, seen, atol=0.08)
    np.testing.assert_allclose(mean["layers/hidden"], seen, atol=0.08)
    assert mean["layers/sky"].max() - mean["layers/sky"].min() < 0.2


def test_stopping_leaves_no_file(tmp_path):
    scene, path = small_street(), tmp_path / "wet.npz"
    job = rainy_preview(scene, small_views(scene, 2), path)
    for step in job:
        if step.fraction > 0.6:
            break
    job.close()
    assert list(tmp_path.iterdir()) == []


def test_no_strength_hardly_changes_the_picture(tmp_path):
    scene, path = small_street(), tmp_path / "same.npz"
    list(rainy_preview(scene, small_views(scene, 2), path, strength=0.0))
    clear, same = (rasterize(each.parts(0.0), new_camera()).over() for each in (scene, recolored(scene, path)))
    assert np.abs(clear - same).mean() < 0.01


def test_the_same_bytes_every_time(finished, tmp_path):
    scene, _, path = finished
    list(rainy_preview(scene, small_views(scene), tmp_path / "again.npz"))
    first, second = read_recolored(path), read_recolored(tmp_path / "again.npz")
    assert all(first[name].tobytes() == second[name].tobytes() for name in first)


def test_all_that_a_worker_is_given_can_be_pickled():
    scene = small_street()
    again, views = pickle.loads(pickle.dumps((scene, small_views(scene))))
    assert again.gaussian_count == scene.gaussian_count
    np.testing.assert_array_equal(views[1].camera.world_to_camera, small_views(scene)[1].camera.world_to_camera)
    assert pickle.loads(pickle.dumps(rainy_preview)) is rainy_preview
    assert pickle.loads(pickle.dumps(Progress(0.5, "half"))) == Progress(0.5, "half")


def test_cameras_are_needed_and_must_see_something(tmp_path):
    scene = small_street()
    with pytest.raises(ValueError, match="at least one camera"):
        list(rainy_preview(scene, [], tmp_path / "wet.npz"))
    blind = Scene("void")
    with pytest.raises(ValueError, match="none of the 2 cameras sees anything of the scene 'void'"):
        list(rainy_preview(blind, small_views(scene, 2), tmp_path / "wet.npz"))


def test_a_view_of_nothing_is_left_out(tmp_path):
    scene = small_street()
    views = small_views(scene, 2)
    up = look_at(np.array([0.0, 0, 500]), np.array([0.0, 0, 600]), np.array([1.0, 0, 0]))
    list(rainy_preview(scene, [*views, PreviewCamera(Camera.from_fov(32, 32, 60, up), 0.0)], tmp_path / "wet.npz"))
    assert (tmp_path / "wet.npz").is_file()


def test_recolored_files_go_and_come_back_with_any_name(tmp_path):
    sh = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    names = ["layers/../odd name", "actors/käfer", "layers/names"]
    write_recolored(tmp_path / "sub" / "a.npz", {name: sh + i for i, name in enumerate(names)})
    back = read_recolored(tmp_path / "sub" / "a.npz")
    assert list(back) == names
    np.testing.assert_array_equal(back["layers/names"], sh + 2)
    assert [each.name for each in (tmp_path / "sub").iterdir()] == ["a.npz"]


@pytest.mark.parametrize("content", [b"", b"no zip at all", b"PK\x03\x04 truncated"])
def test_other_files_are_refused_with_their_name(tmp_path, content):
    path = tmp_path / "bad.npz"
    path.write_bytes(content)
    with pytest.raises(SceneFormatError, match=r"bad\.npz: not a file of recoloured Gaussians"):
        read_recolored(path)


def test_wrong_arrays_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", version=np.array(1), names=np.array(["layers/x"]), sh_0=np.zeros(3))
    with pytest.raises(SceneFormatError, match="expected float32"):
        read_recolored(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", version=np.array(9), names=np.array(["layers/x"]))
    with pytest.raises(SceneFormatError, match="version 9 is newer"):
        read_recolored(tmp_path / "b.npz")


def test_deleted_gaussians_and_grading_stay_what_they_are(tmp_path):
    scene = small_street()
    road = scene.layers[0]
    deleted = Mask.of(np.arange(len(road.gaussians)) % 3 == 0)
    scene = scene.with_member(road.key, marks=Marks(deleted=deleted))
    graded = scene.with_member(road.key, grading=Grading(exposure_ev=-2.0))
    for each, name in ((scene, "plain"), (graded, "graded")):
        for _ in rainy_preview(each, small_views(scene, 1), tmp_path / name):
            pass
    plain, same = (read_recolored(tmp_path / name) for name in ("plain", "graded"))
    assert plain[road.key].shape == road.gaussians.sh.shape
    assert all(np.array_equal(plain[key], same[key]) for key in plain)
    kept = plain[road.key][(~deleted).indices]
    np.testing.assert_array_equal(with_colors(scene, {road.key: kept}).layers[0].wet_sh[(~deleted).indices], kept)
    np.testing.assert_array_equal(with_colors(scene, plain).layers[0].wet_sh, plain[road.key])
