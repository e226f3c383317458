"""Scene folders: all of a scene comes back, nothing is ever lost, and bad folders are refused in one line."""

import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats import scene_folder
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, RigCamera, Scene

from .sample_gaussians import assert_equal, sample_gaussians


def track(samples: int) -> PoseTrack:
    turns = np.linspace(0, 1, samples)
    quaternions = np.stack([np.cos(turns), 0 * turns, 0 * turns, np.sin(turns)], axis=1)
    return PoseTrack(turns * 3, np.random.default_rng(2).normal(size=(samples, 3)), quaternions, turns < 0.8)


def sample_scene() -> Scene:
    pose = np.eye(4)
    pose[:3] = [[0, 0, 1, 1.5], [-1, 0, 0, 0], [0, -1, 0, 0.1]]
    camera = RigCamera("FRONT", 1920, 1280, 2059.0, 2058.5, 957.0, 640.0, pose, 0.003)
    return Scene(
        name="Regenstraße",
        layers=(
            Layer("road & kerb", sample_gaussians(50, 0)),
            Layer("sky", sample_gaussians(20, 1), kind="sky", visible=False),
        ),
        actors=(Actor("lead/1", "car", (4.5, 1.8, 1.5), sample_gaussians(30, 3), track(5), visible=False),),
        metres_per_unit=3.7,
        up=(0.1, -0.9, 0.2),
        ground_m=-1.25,
        rigs={"waymo": (camera, replace(camera, name="LEFT"))},
        ego=track(3),
        rain={"intensity_mm_h": 8.5, "wind": [1.0, 0.5], "haze": {"count": None}},
    )


def with_nan_in_mean(index: int) -> Gaussians:
    some = sample_gaussians(4)
    means = some.means.copy()
    means[index, 2] = np.nan
    return Gaussians(means, some.scales, some.quaternions, some.opacities, some.sh)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_scene(sample_scene(), tmp_path / "saved")
    return tmp_path / "saved"


def edit(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    values = json.loads((folder / "scene.json").read_text())
    change(values)
    (folder / "scene.json").write_text(json.dumps(values))


def refused(folder: Path) -> str:
    with pytest.raises(SceneFormatError) as error:
        read_scene(folder)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_everything_comes_back(folder: Path) -> None:
    expected, found = sample_scene(), read_scene(folder)
    for name in ("name", "metres_per_unit", "up", "ground_m", "rain"):
        assert getattr(found, name) == getattr(expected, name)
    for a, b in zip(found.layers, expected.layers, strict=True):
        assert (a.name, a.kind, a.visible) == (b.name, b.kind, b.visible)
        assert_equal(a.gaussians, b.gaussians)
    (a,), (b,) = found.actors, expected.actors
    assert (a.id, a.class_name, a.size_lwh, a.visible) == (b.id, b.class_name, b.size_lwh, b.visible)
    assert_equal(a.gaussians, b.gaussians)
    for a, b in ((found.actors[0].track, expected.actors[0].track), (found.ego, expected.ego)):
        assert a is not None and b is not None
        for name in ("times", "positions", "quaternions_wxyz", "valid"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    (cameras,) = found.rigs.values()
    assert list(found.rigs) == ["waymo"]
    for a, b in zip(cameras, expected.rigs["waymo"], strict=True):
        np.testing.assert_array_equal(a.camera_to_ego, b.camera_to_ego)
        assert replace(a, camera_to_ego=b.camera_to_ego).__repr__() == b.__repr__()


def test_a_bare_scene_comes_back(tmp_path: Path) -> None:
    write_scene(Scene("empty"), tmp_path / "e")
    found = read_scene(tmp_path / "e")
    assert (found.name, found.layers, found.actors, found.ego, found.rain) == ("empty", (), (), None, None)


def test_the_json_file_stands_for_its_folder(folder: Path) -> None:
    assert read_scene(folder / "scene.json").name == "Regenstraße"


def test_the_same_scene_makes_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    write_scene(sample_scene(), tmp_path / "again")
    files = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    assert [str(file.parent) for file in files] == ["actors", "layers", "layers", "."]
    for file in files:
        assert (tmp_path / "again" / file).read_bytes() == (folder / file).read_bytes()


def test_replacing_leaves_the_new_scene_and_other_peoples_files(folder: Path) -> None:
    (folder / "layers" / "notes.txt").write_text("mine")
    scene = sample_scene()
    changed = replace(scene, name="new", layers=(scene.layers[0], Layer("more", sample_gaussians(5, seed=9))))
    write_scene(changed, folder)
    found = read_scene(folder)
    assert (found.name, [layer.name for layer in found.layers]) == ("new", ["road & kerb", "more"])
    assert_equal(found.layers[1].gaussians, changed.layers[1].gaussians)
    assert (folder / "layers" / "notes.txt").read_text() == "mine"
    assert len(list(folder.rglob("*.ply"))) == 3
    assert not [path for path in folder.parent.rglob("*") if path.suffix == ".part"]


def failing(name: str, calls: int) -> Callable[[pytest.MonkeyPatch], None]:
    """A disk that refuses the n-th call of a function."""

    def patch(monkeypatch: pytest.MonkeyPatch) -> None:
        module, attribute = {"write_ply": (scene_folder, "write_ply"), "fsync": (os, "fsync")}.get(name, (Path, name))
        real = getattr(module, attribute)
        left = [calls]

        def fails(*arguments: Any, **options: Any) -> Any:
            left[0] -= 1
            if left[0] == 0:
                raise OSError(28, "No space left on device")
            return real(*arguments, **options)

        monkeypatch.setattr(module, attribute, fails)

    return patch


FAILURES = [("write_ply", 1), ("write_ply", 2), ("fsync", 1), ("fsync", 3), ("write_bytes", 1)]


@pytest.mark.parametrize(("name", "calls"), [*FAILURES, ("replace", 1), ("replace", 3), ("replace", 4)])
def test_a_failure_while_replacing_loses_nothing(
    name: str, calls: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    scene = sample_scene()
    changed = replace(scene, layers=(scene.layers[0], Layer("b", sample_gaussians(9, seed=5))))
    with monkeypatch.context() as patched:
        failing(name, calls)(patched)
        with pytest.raises(OSError, match="No space left"):
            write_scene(changed, folder)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    assert read_scene(folder).layers[1].name == "sky"


@pytest.mark.parametrize(("name", "calls"), [*FAILURES, ("replace", 1), ("rename", 1)])
def test_a_failure_while_writing_leaves_nothing(
    name: str, calls: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        failing(name, calls)(patched)
        with pytest.raises(OSError, match="No space left"):
            write_scene(sample_scene(), tmp_path / "new")
    assert list(tmp_path.iterdir()) == []


NAN = float("nan")
UNREADABLE: dict[str, tuple[dict[str, Any], str]] = {
    "scale": (
        {"metres_per_unit": 0.0},
        "scene.json: can't be written: Expected `float` > 0.0 - at `$.metres_per_unit`",
    ),
    "up": ({"up": (0.0, 0.0, 0.0)}, "scene.json: can't be written: `$.up` must be a direction"),
    "ground": ({"ground_m": NAN}, "expected a finite number - at `$.ground_m`"),
    "rain": ({"rain": {"a": [0.5, {"b": -np.inf}]}}, "expected a finite number - at `$.rain.a[1].b`"),
    "track": ({"ego": replace(track(3), times=np.array([0.0, 2, 1]))}, "times must rise - at `$.ego`"),
    "track position": (
        {"ego": replace(track(3), positions=np.full((3, 3), NAN))},
        "expected a finite number - at `$.ego.positions[0][0]`",
    ),
    "name": ({"name": "\ud800"}, "scene.json: can't be written: 'utf-8' codec"),
    "values": (
        {"layers": (Layer("a", sample_gaussians(2)), Layer("b", with_nan_in_mean(1)))},
        "1 of 4 Gaussians have a mean of layer 'b' that is not a finite number, the first is number 1",
    ),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_a_scene_that_could_not_be_read_again_replaces_nothing(name: str, folder: Path) -> None:
    changes, message = UNREADABLE[name]
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    for place in (folder, folder.parent / "new"):
        with pytest.raises(SceneFormatError, match=re.escape(message)) as error:
            write_scene(replace(sample_scene(), **changes), place)
        assert str(error.value).startswith(str(place)) and "\n" not in str(error.value)
    assert {path: path.read_bytes() for path in folder.parent.rglob("*") if path.is_file()} == before


def test_an_empty_folder_is_filled(tmp_path: Path) -> None:
    (tmp_path / "e").mkdir()
    write_scene(sample_scene(), tmp_path / "e")
    assert len(read_scene(tmp_path / "e").layers) == 2


def test_folders_that_are_no_scenes_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(b"precious")
    with pytest.raises(SceneFormatError, match="it holds files but no scene"):
        write_scene(sample_scene(), tmp_path / "photos")
    (tmp_path / "photos" / "scene.json").write_text('{"objects": []}')
    with pytest.raises(SceneFormatError, match="not the description of a scene"):
        write_scene(sample_scene(), tmp_path / "photos")
    (tmp_path / "file").write_bytes(b"precious")
    with pytest.raises(SceneFormatError, match="a file of that name is in the way"):
        write_scene(sample_scene(), tmp_path / "file")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a.jpg", "file", "photos", "scene.json"]


def test_a_newer_version_is_neither_read_nor_replaced(folder: Path) -> None:
    edit(folder, lambda values: values.update(version=5, new_field=True))
    assert refused(folder).endswith("version 5 is of a newer program; this one reads versions up to 4")
    before = (folder / "scene.json").read_bytes()
    with pytest.raises(SceneFormatError, match="newer program"):
        write_scene(sample_scene(), folder)
    assert (folder / "scene.json").read_bytes() == before


def test_an_older_version_lacks_fields(folder: Path) -> None:
    def older(values: dict[str, Any]) -> None:
        for name in ("rain", "rigs", "ego", "actors", "ground_m", "metres_per_unit", "up"):
            del values[name]
        del values["layers"][0]["kind"], values["layers"][0]["visible"]
        values["version"] = 0

    edit(folder, older)
    found = read_scene(folder)
    assert (found.metres_per_unit, found.up, len(found.layers), found.actors) == (1.0, (0.0, 0.0, 1.0), 2, ())
    assert found.layers[0].visible


def test_a_damaged_scene_may_be_replaced(folder: Path) -> None:
    edit(folder, lambda values: values.update(up="left"))
    write_scene(sample_scene(), folder)
    assert read_scene(folder).up == (0.1, -0.9, 0.2)


BAD_VALUES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "unknown field": (lambda v: v.update(color="red"), "unknown field `color`"),
    "no version": (lambda v: v.pop("version"), "required field `version`"),
    "wrong type": (lambda v: v.update(metres_per_unit="3"), "Expected `float`, got `str` - at `$.metres_per_unit`"),
    "out of range": (lambda v: v.update(metres_per_unit=0), "Expected `float` > 0.0 - at `$.metres_per_unit`"),
    "in a layer": (
        lambda v: v["layers"][1].update(kind="ocean"),
        "Invalid enum value 'ocean', expected background, sky - at `$.layers[1].kind`",
    ),
    "in a track": (lambda v: v["actors"][0]["track"]["times"].pop(), "equally long - at `$.actors[0].track`"),
    "falling times": (lambda v: v["ego"].update(times=[2, 1, 0]), "times must rise - at `$.ego`"),
    "time that stands still": (lambda v: v["ego"].update(times=[0, 1, 1]), "times must rise - at `$.ego`"),
    "zero quaternion": (
        lambda v: v["ego"].update(quaternions_wxyz=[[0, 0, 0, 0]] * 3),
        "quaternion 0 must be above 0 long and finite, not 0 - at `$.ego`",
    ),
    "endless quaternion": (
        lambda v: v["actors"][0]["track"]["quaternions_wxyz"].__setitem__(2, [1e200, 0, 0, 0]),
        "quaternion 2 must be above 0 long and finite, not inf - at `$.actors[0].track`",
    ),
    "endless direction": (lambda v: v.update(up=[1e200, 0, 0]), "`$.up` must be a direction, not [1e+200, 0.0, 0.0]"),
    "endless camera pose": (
        lambda v: v["rigs"]["waymo"][1]["camera_to_ego"].__setitem__(0, [1e200, -1e200, 1e200, 0]),
        "camera_to_ego of camera 'LEFT' must be a rotation",
    ),
    "last row of a camera pose": (
        lambda v: v["rigs"]["waymo"][1]["camera_to_ego"].__setitem__(3, [0, 0, 0, 2]),
        "camera_to_ego of camera 'LEFT' must be a rotation",
    ),
    "no direction": (lambda v: v.update(up=[0, 0, 0]), "`$.up` must be a direction, not [0.0, 0.0, 0.0]"),
    "camera size": (lambda v: v["rigs"]["waymo"][0].update(width=0), "Expected `int` >= 1 - at `$.rigs[...][0].width`"),
    "camera pose": (
        lambda v: v["rigs"]["waymo"][1].update(camera_to_ego=[[1, 0, 0, 0]] * 4),
        "camera_to_ego of camera 'LEFT' must be a rotation",
    ),
    "file missing": (lambda v: v["layers"][0].update(file="layers/none.ply"), "there is no file 'layers/none.ply'"),
    "file above": (
        lambda v: v["layers"][0].update(file="../outside.ply"),
        "'../outside.ply' must lie inside the scene",
    ),
    "file deeper above": (lambda v: v["layers"][0].update(file="layers/../../outside.ply"), "must lie inside"),
    "file elsewhere": (lambda v: v["layers"][0].update(file="/etc/passwd"), "'/etc/passwd' must lie inside"),
    "file by a link to nothing": (lambda v: v["layers"][0].update(file="link.ply"), "a link to nowhere.ply)"),
    "file with a zero": (lambda v: v["layers"][0].update(file="a\0b"), "there is no file 'a\\x00b'"),
    "a file twice": (lambda v: v["layers"][0].update(file=v["layers"][1]["file"]), "must belong to one layer or actor"),
    "no known format": (lambda v: v["layers"][0].update(file="scene.json"), "no known scene format"),
}


@pytest.mark.parametrize("name", BAD_VALUES)
def test_bad_values_are_named(name: str, folder: Path) -> None:
    (folder.parent / "outside.ply").write_bytes(next(folder.rglob("*.ply")).read_bytes())
    (folder / "link.ply").symlink_to("nowhere.ply")
    change, message = BAD_VALUES[name]
    edit(folder, change)
    assert message in refused(folder)


@pytest.mark.parametrize("text", ["", "{", "null", "[]", '{"version": 1e999}', '{"version": NaN}', "\xff", "[" * 10**6])
def test_what_is_no_json_is_refused(text: str, folder: Path) -> None:
    (folder / "scene.json").write_bytes(text.encode("latin-1"))
    assert "scene.json: not the description of a scene" in refused(folder)


def test_deep_nesting_in_the_rain_is_refused(folder: Path) -> None:
    data = (folder / "scene.json").read_text()
    nested = '"rain": {"a": ' + "[" * 200_000 + "]" * 200_000 + "}"
    (folder / "scene.json").write_text(re.sub(r'"rain": \{.*\}', nested, data, flags=re.DOTALL) + "}")
    assert "recursion" in refused(folder)


def test_endless_json_is_not_read(folder: Path) -> None:
    os.truncate(folder / "scene.json", 2**26 + 1)
    assert "larger than 67 MB" in refused(folder)


def test_a_damaged_layer_names_its_own_file(folder: Path) -> None:
    ply = next((folder / "layers").glob("*.ply"))
    os.truncate(ply, ply.stat().st_size - 1)
    assert refused(folder).startswith(str(ply))


def test_a_folder_without_a_scene_is_refused(tmp_path: Path) -> None:
    assert "holds scene.json and a SOG folder meta.json; this has neither" in refused(tmp_path)
