"""Wet colors in scene folders (version 3): kept bit for bit, not written again, linked; what is damaged is named."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.formats.scene_folder import FileCache, read_harmonics, write_harmonics, write_scene_folder
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, Scene

from .sample_gaussians import sample_gaussians


def wet_of(gaussians, seed=9):
    return np.random.default_rng(seed).normal(0, 0.3, gaussians.sh.shape).astype(np.float32)


def wet_scene() -> Scene:
    road, sky, car = sample_gaussians(40, 3), sample_gaussians(7, 0), sample_gaussians(12, 1)
    track = PoseTrack(np.arange(2.0), np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))
    layers = (Layer("road", road, wet_sh=wet_of(road)), Layer("sky", sky, "sky"))
    return Scene("wet", layers, (Actor("car", "car", (4.0, 2.0, 1.0), car, track, wet_sh=wet_of(car)),))


def files(folder: Path) -> list[str]:
    return sorted(each.name for each in folder.rglob("*") if each.is_file())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_scene(wet_scene(), tmp_path / "s")
    return tmp_path / "s"


def test_wet_colours_come_back_to_the_bit(folder: Path) -> None:
    scene, back = wet_scene(), read_scene(folder)
    for each, found in zip(scene.members, back.members, strict=True):
        if each.wet_sh is None:
            assert found.wet_sh is None
        else:
            np.testing.assert_array_equal(found.wet_sh, each.wet_sh)
            assert found.wet_sh.flags.writeable  # kernels are compiled for such arrays
    assert [name.rpartition("-")[0] for name in files(folder)[:-1]] == [
        "000-road",
        "000-road",
        "001-sky",
        "002-car",
        "002-car",
    ]


def test_other_programs_find_the_clear_scene(folder: Path) -> None:
    (clear,) = (folder / "layers").glob("000-road-*.ply")
    np.testing.assert_array_equal(read_scene(clear).layers[0].gaussians.sh, wet_scene().layers[0].gaussians.sh)
    (wet,) = (folder / "layers").glob("000-road-*.wet.npy")
    np.testing.assert_array_equal(np.load(wet), wet_scene().layers[0].wet_sh)


def test_a_folder_of_version_2_has_no_wet_colours(folder: Path) -> None:
    values = json.loads((folder / "scene.json").read_text())
    for each in (*values["layers"], *values["actors"]):
        del each["wet_file"]
    values["version"] = 2
    (folder / "scene.json").write_text(json.dumps(values))
    assert all(each.wet_sh is None for each in read_scene(folder).members)


def test_only_what_has_changed_is_written(folder: Path) -> None:
    known = FileCache()
    scene = read_scene(folder, known)
    before = {path: path.stat().st_ino for path in folder.rglob("*.*") if path.name != "scene.json"}
    write_scene(replace(scene, name="renamed"), folder, known)
    assert {path: path.stat().st_ino for path in before} == before
    darker = scene.with_member("layers/road", wet_sh=scene.layers[0].wet_sh * np.float32(0.5))
    write_scene(darker, folder, known)
    gone = [path for path in before if not path.exists()]
    assert [path.name[:8] + path.suffix for path in gone] == ["000-road.npy"]
    np.testing.assert_array_equal(read_scene(folder).layers[0].wet_sh, darker.layers[0].wet_sh)
    write_scene(darker.with_member("layers/road", wet_sh=None), folder, known)
    assert sum(name.endswith(".wet.npy") for name in files(folder)) == 1
    assert read_scene(folder).layers[0].wet_sh is None


def test_a_copy_is_linked(folder: Path, tmp_path: Path) -> None:
    known = FileCache()
    scene = read_scene(folder, known)
    write_scene_folder(scene, tmp_path / "copy", known, linking=True)
    assert files(tmp_path / "copy") == files(folder)
    originals = {each.name: each.stat().st_ino for each in folder.rglob("*.npy")}
    assert {each.name: each.stat().st_ino for each in (tmp_path / "copy").rglob("*.npy")} == originals


def test_what_is_not_finite_is_not_written(tmp_path: Path) -> None:
    scene = wet_scene()
    bad = scene.layers[0].wet_sh.copy()
    bad[3, 1, 2] = np.nan
    with pytest.raises(
        SceneFormatError, match="a wet color of layer 'road' that is not a finite number, the first is number 3"
    ):
        write_scene(scene.with_member("layers/road", wet_sh=bad), tmp_path / "s")
    assert not (tmp_path / "s").exists()


DAMAGE = {
    "empty": (lambda data: b"", "no array file of wet colors"),
    "cut off": (lambda data: data[:-4], "does not end after the 7,680 bytes"),
    "too long": (lambda data: data + b"\0", "does not end after the 7,680 bytes"),
    "other numbers": (lambda data: data.replace(b"<f4", b"<i4"), "int32 (40, 16, 3), expected float32 (40, 16, 3)"),
    "objects": (lambda data: data.replace(b"'<f4'", b"'|O' "), "holds object, not real numbers"),
    "other order": (lambda data: data.replace(b"False", b"True "), "in Fortran's order"),
    "other shape": (lambda data: data.replace(b"(40, 16, 3)", b"(16, 40, 3)"), "(16, 40, 3), expected float32 (40,"),
    "a lie": (lambda data: data.replace(b"(40, 16, 3)", b"(9**40, 1,)"), "no array file of wet colors"),
    "not finite": (lambda data: data[:-4] + np.float32(np.inf).tobytes(), "a wet color that is not a finite number"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damage_is_named(name: str, folder: Path) -> None:
    damage, problem = DAMAGE[name]
    (path,) = (folder / "layers").glob("000-road-*.wet.npy")
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(SceneFormatError) as error:
        read_scene(folder)
    assert problem in str(error.value)
    assert path.name in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("wet_file", "problem"),
    [
        ("../x.wet.npy", "must lie inside"),
        ("layers/gone.wet.npy", "there is no file"),
        ("clear", "one layer or actor only"),
    ],
)
def test_wet_files_stand_in_the_folder_and_are_used_once(wet_file: str, problem: str, folder: Path) -> None:
    values = json.loads((folder / "scene.json").read_text())
    layer = values["layers"][0]
    layer["wet_file"] = layer["file"] if wet_file == "clear" else wet_file
    (folder / "scene.json").write_text(json.dumps(values))
    with pytest.raises(SceneFormatError, match=problem):
        read_scene(folder)


def test_harmonics_that_lie_in_memory_anyhow_are_written(tmp_path: Path) -> None:
    sh = np.arange(48, dtype=np.float32).reshape(3, 4, 4)[:, :, 3:0:-1]
    write_harmonics(sh, tmp_path / "x")
    np.testing.assert_array_equal(read_harmonics(tmp_path / "x", (3, 4, 3)), sh)
