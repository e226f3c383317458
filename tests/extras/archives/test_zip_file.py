"""Zip files of one scene: a file, a folder, the output of a training; others in one sentence."""

from pathlib import Path

import pytest

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats import read_scene, write_scene
from gsrain_engine.scene.scene import Layer, Scene
from tests.scene.formats.sample_files import archive, assert_equal, sample_gaussians, written


def zipped(path: Path, files: dict[str, bytes]) -> Path:
    path.write_bytes(archive(files))
    return path


def test_a_zip_file_of_one_scene_is_read_as_that(tmp_path: Path) -> None:
    expected = sample_gaussians(50)
    ply = written(expected, ".ply")
    noise = {"__MACOSX/a/._plant.ply": b"x", "a/.DS_Store": b"x", "a/readme.md": b"# A plant"}
    scene = read_scene(zipped(tmp_path / "plant.zip", {"a/plant.ply": ply, **noise}))
    assert scene.name == "plant"
    assert_equal(scene.layers[0].gaussians, expected)

    write_scene(Scene("street", (Layer("road", expected),)), tmp_path / "folder")
    folder = tmp_path / "folder"
    inside = [each for each in folder.rglob("*") if each.is_file()]
    files = {f"deep/er/{each.relative_to(folder).as_posix()}": each.read_bytes() for each in inside}
    found = read_scene(zipped(tmp_path / "folder.zip", files))
    assert found.name == "street"
    assert_equal(found.layers[0].gaussians, expected)


def test_the_last_iteration_of_a_training_counts(tmp_path: Path) -> None:
    last = sample_gaussians(30, seed=2)
    files = {
        "garden/cameras.json": b"[]",
        "garden/cfg_args": b"Namespace(sh_degree=3)",
        "garden/point_cloud/iteration_7000/point_cloud.ply": written(sample_gaussians(20), ".ply"),
        "garden/point_cloud/iteration_30000/point_cloud.ply": written(last, ".ply"),
    }
    assert_equal(read_scene(zipped(tmp_path / "garden.zip", files)).layers[0].gaussians, last)


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({}, "it holds no scene"),
        ({"readme.md": b"x"}, "it holds no scene"),
        ({"a.ply": b"x", "b.spz": b"x"}, r"it holds 2 scenes \(a.ply, b.spz\): unpack it"),
        ({"a/scene.json": b"{}", "b/scene.json": b"{}"}, r"it holds 2 scenes \(scene.json\)"),
        ({"../a.ply": b"x"}, "no name of a file inside of it"),
        ({"a.ply": b"x"}, "not a PLY"),
        ({"a/scene.json": b"{"}, "scene.json in it: "),
        ({"a.zip": b"x"}, "it holds no scene"),
    ],
)
def test_other_zip_files_are_refused(files: dict[str, bytes], told: str, tmp_path: Path) -> None:
    path = zipped(tmp_path / "a.zip", files)
    with pytest.raises(SceneFormatError, match=told) as caught:
        read_scene(path)
    assert caught.value.path == path
