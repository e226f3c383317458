"""Scene folders: all of a scene comes back, failures lose nothing, and links are followed but never overwritten."""

import os
import shutil
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats import scene_folder
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.formats.scene_folder import FileCache, write_scene_folder
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.geometry import matrices_from_quaternions, normalized
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.named_view import NamedView
from gsrain_engine.scene.scene import Actor, ColorGrading, Layer, PoseTrack, RigCamera, Scene

from ..test_camera_path import path_of
from .sample_files import assert_equal, sample_gaussians


def track(samples: int) -> PoseTrack:
    turns = np.linspace(0, 1, samples)
    quaternions = np.stack([np.cos(turns), 0 * turns, 0 * turns, np.sin(turns)], axis=1)
    return PoseTrack(turns * 3, np.random.default_rng(2).normal(size=(samples, 3)), quaternions, turns < 0.8)


def wet_of(gaussians: Gaussians) -> np.ndarray:
    return np.random.default_rng(9).normal(0, 0.3, gaussians.sh.shape).astype(np.float32)


def sample_scene() -> Scene:
    """A scene that has everything: 50 Gaussians of a road, 20 of a sky, 30 of a car, wet colors of road and car."""
    pose = np.eye(4)
    pose[:3] = [[0, 0, 1, 1.5], [-1, 0, 0, 0], [0, -1, 0, 0.1]]
    camera = RigCamera("FRONT", 1920, 1280, 2059.0, 2058.5, 957.0, 640.0, pose, 0.003)
    road, sky, car = sample_gaussians(50, 0), sample_gaussians(20, 1), sample_gaussians(30, 3)
    marks = SelectionFlags(hidden=BitMask.of(np.arange(50) % 3 == 0), deleted=BitMask.of(np.arange(50) == 7))
    turns = np.linspace(0, 1, 4)
    quaternions = np.stack([np.cos(turns), 0 * turns, np.sin(turns), 0 * turns], axis=1)
    return Scene(
        name="Regenstraße",
        layers=(
            Layer("road & kerb", road, marks=marks, wet_sh=wet_of(road), opacity=0.5),
            Layer("sky", sky, kind="sky", visible=False),
        ),
        actors=(Actor("lead/1", "car", (4.5, 1.8, 1.5), car, track(5), visible=False, wet_sh=wet_of(car)),),
        metres_per_unit=3.7,
        up=(0.1, -0.9, 0.2),
        ground_m=-1.25,
        rigs={"waymo": (camera, replace(camera, name="LEFT"))},
        ego=track(3),
        path=CameraPath(turns * 2, np.stack([turns, turns**2, 1 - turns], axis=1), quaternions, 40 + 10 * turns),
        rain={"intensity_mm_h": 8.5, "wind": [1.0, 0.5], "haze": {"count": None}},
        weather={"keys": [{"time_s": 0.0, "intensity_mm_h": 2.0}]},
        view={"time_s": 1.0},
        views=(
            NamedView(name="Tür 1", position=(1.0, 2.0, 3.0), quaternion_wxyz=(0.5, -0.5, 0.5, -0.5)),
            NamedView(
                name="back",
                position=(0.1, 0.0, -3.0),
                quaternion_wxyz=(0.6, 0.0, 0.8, 0.0),
                vertical_fov_deg=31.5,
                target=(9.0, 0.0, 0.25),
                time_s=2.5,
                rain={"intensity_mm_h": 12.0},
                picture=b"\xff\xd8small",
            ),
        ),
        lamps=(Lamp(name="lantern", position=(1.0, 2.0, 4.0), intensity_m2=30.0, inner_deg=40.0, outer_deg=70.0),),
        selections={"set": {"layers/road & kerb": BitMask.of(np.arange(50) < 9)}},
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_scene(sample_scene(), tmp_path / "saved")
    return tmp_path / "saved"


def bytes_in(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def first_file(folder: Path) -> Path:
    """Gaussians of the road."""
    return next((folder / "layers").glob("000-*.ply"))


def assert_same(found: Any, expected: Any, place: str = "scene") -> None:
    """Assert that two values have the same fields to the bit; Gaussians to the rounding of logarithms."""
    assert type(found) is type(expected), place
    match expected:
        case Gaussians():
            assert_equal(found, expected)
        case np.ndarray():
            np.testing.assert_array_equal(found, expected, place)
        case dict():
            assert found.keys() == expected.keys(), place
            for name, value in expected.items():
                assert_same(found[name], value, f"{place}.{name}")
        case tuple() | list():
            for number, (a, b) in enumerate(zip(found, expected, strict=True)):
                assert_same(a, b, f"{place}[{number}]")
        case _ if is_dataclass(expected):
            for field in fields(expected):
                assert_same(getattr(found, field.name), getattr(expected, field.name), f"{place}.{field.name}")
        case _:
            assert found == expected, place


# Round trips


def any_scene(draw: Callable[[st.SearchStrategy[Any]], Any]) -> Scene:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))

    def mask(count: int) -> BitMask | None:
        flags = rng.random(count) < draw(st.sampled_from([0.0, 0.1, 1.0]))
        return BitMask.of(flags) if flags.any() else None

    def member_fields(count: int) -> dict[str, Any]:
        grading = ColorGrading(exposure_ev=draw(st.floats(-6, 6)), saturation=draw(st.floats(0, 3)))
        marks = SelectionFlags(mask(count), mask(count), mask(count))
        flags = {name: draw(st.booleans()) for name in ("visible", "locked")}
        return {**flags, "opacity": draw(st.floats(0, 1)), "grading": grading, "marks": marks}

    layers: list[Layer] = []
    for number in range(draw(st.integers(0, 3))):
        gaussians = sample_gaussians(draw(st.sampled_from([0, 1, 31, 32, 33, 70])), seed=number)
        placed = np.eye(4)
        turn = matrices_from_quaternions(normalized(rng.normal(size=4)))
        placed[:3] = np.column_stack([draw(st.floats(1e-3, 1e3)) * turn, rng.normal(0, 1e5, 3)])
        rest = member_fields(len(gaussians))
        layers.append(Layer(f"{draw(st.text(max_size=5))}{number}", gaussians, "sky", placed, **rest))
    actor = Actor("car", "car", (4.0, 2.0, 1.0), sample_gaussians(9), track(2), **member_fields(9))
    path = path_of(
        draw(st.integers(1, 4)),
        draw(st.integers(0, 99)),
        exposure_s=draw(st.floats(1e-4, 1)),
        interpolation=draw(st.sampled_from(["spline", "linear"])),
        easing=draw(st.sampled_from(["none", "in and out", "at each key"])),
        loop=draw(st.booleans()),
        is_timed=draw(st.booleans()),
    )
    chosen = {each.key: found for each in (*layers, actor) if (found := mask(len(each.gaussians))) is not None}
    return Scene(
        "s",
        tuple(layers),
        (actor,),
        path=draw(st.none() | st.just(path)),
        weather=draw(st.none() | st.dictionaries(st.text(), st.floats(-1e6, 1e6))),
        view=draw(st.none() | st.dictionaries(st.text(), st.text())),
        selections=draw(st.dictionaries(st.text(max_size=4), st.just(chosen), max_size=2)),
    )


@settings(max_examples=30)
@given(data=st.data())
def test_any_scene_comes_back(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    scene, folder = any_scene(data.draw), tmp_path_factory.mktemp("scene") / "saved"
    write_scene(scene, folder)
    assert_same(read_scene(folder), scene)


def test_a_scene_comes_back_from_its_folder_or_its_json_and_makes_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    for path in (folder, folder / "scene.json"):
        assert_same(read_scene(path), sample_scene())
    write_scene(sample_scene(), tmp_path / "again")
    names = [path.relative_to(folder).as_posix().rpartition("-")[0] for path in sorted(bytes_in(folder))]
    assert names == ["actors/002-lead-1", "actors/002-lead-1", "layers/000-road-kerb", "layers/000-road-kerb",
                     "layers/001-sky", ""]  # fmt: skip
    for path, content in bytes_in(folder).items():
        assert (tmp_path / "again" / path.relative_to(folder)).read_bytes() == content


def test_a_bare_scene_comes_back_from_a_new_or_an_empty_folder(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("new", "empty"):
        write_scene(Scene("bare"), tmp_path / name)
        assert_same(read_scene(tmp_path / name), Scene("bare"))


def test_other_programs_find_clear_and_wet_colors_in_any_order_in_memory(folder: Path) -> None:
    scene = sample_scene()
    clear = scene.layers[0].gaussians.sh
    wet = np.arange(clear.size, dtype=np.float32).reshape(3, -1, 50).transpose(2, 1, 0)[..., ::-1]
    write_scene(scene.with_member("layers/road & kerb", wet_sh=wet), folder)
    np.testing.assert_array_equal(read_scene(first_file(folder)).layers[0].gaussians.sh, clear)
    (file,) = (folder / "layers").glob("000-road-*.wet.npy")
    np.testing.assert_array_equal(np.load(file), wet)
    found = read_scene(folder).layers[0].wet_sh
    assert found is not None and found.flags.writeable  # kernels are compiled for such arrays


# Replacing a scene


def test_replacing_leaves_the_new_scene_and_other_peoples_files(folder: Path) -> None:
    (folder / "layers" / "notes.txt").write_text("mine")
    scene = sample_scene()
    changed = replace(
        scene, name="new", layers=(scene.layers[0], Layer("more", sample_gaussians(5, seed=9))), selections={}
    )
    write_scene(changed, folder)
    assert_same(read_scene(folder), changed)
    assert (folder / "layers" / "notes.txt").read_text() == "mine"
    assert len(list(folder.rglob("*.ply"))) == 3
    assert not [path for path in folder.parent.rglob("*") if path.suffix == ".part"]


def refuse_call(name: str, calls: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the disk be full at the n-th call of a function."""
    module, attribute = {"write_ply": (scene_folder, "write_ply"), "fsync": (os, "fsync")}.get(name, (Path, name))
    real = getattr(module, attribute)
    left = [calls]

    def refused(*arguments: Any, **options: Any) -> Any:
        left[0] -= 1
        if left[0] == 0:
            raise OSError(28, "No space left on device")
        return real(*arguments, **options)

    monkeypatch.setattr(module, attribute, refused)


FULL_AT = [("write_ply", 1), ("write_ply", 2), ("fsync", 1), ("fsync", 3), ("write_bytes", 1), ("replace", 1),
           ("replace", 4)]  # fmt: skip


@pytest.mark.parametrize("is_there", [True, False])
@pytest.mark.parametrize(("name", "calls"), FULL_AT)
def test_a_failure_loses_nothing_and_leaves_nothing(
    is_there: bool, name: str, calls: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = bytes_in(folder.parent)
    changed = replace(sample_scene(), layers=(sample_scene().layers[0], Layer("b", sample_gaussians(9, seed=5))))
    with monkeypatch.context() as patched:
        refuse_call(name, calls, patched)
        with pytest.raises(OSError, match="No space left"):
            write_scene(replace(changed, selections={}), folder if is_there else folder.parent / "new")
    assert bytes_in(folder.parent) == before and list(folder.parent.iterdir()) == [folder]


def test_folders_that_are_no_scenes_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(b"precious")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "scene.json").write_text('{"objects": []}')
    (tmp_path / "file").write_bytes(b"precious")
    before = bytes_in(tmp_path)
    for name in ("photos", "other", "file"):
        with pytest.raises(SceneFormatError, match=name):
            write_scene(sample_scene(), tmp_path / name)
    assert bytes_in(tmp_path) == before


def test_a_scene_that_is_replaced_while_it_is_read_is_read_as_the_new_one(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    newer = Scene("newer", (Layer("n", sample_gaussians(7, 3)),))
    reading, read = scene_folder.read_gaussians, list[Path]()

    def replaced(path: Path) -> Gaussians:
        read.append(path)
        if len(read) == 1:
            write_scene(newer, folder)
        return reading(path)

    monkeypatch.setattr(scene_folder, "read_gaussians", replaced)
    assert_same(read_scene(folder), newer)


# Files whose contents are known


def test_only_what_has_changed_is_written(folder: Path) -> None:
    known = FileCache()
    scene = read_scene(folder, known)
    before = {path: path.stat().st_ino for path in folder.rglob("*.*") if path.name != "scene.json"}
    swapped = replace(scene, layers=(scene.layers[1], replace(scene.layers[0], name="c")), selections={})
    write_scene(swapped, folder, known)
    assert {path: path.stat().st_ino for path in before} == before
    assert_same(read_scene(folder), swapped)
    darker = swapped.with_member("layers/c", wet_sh=wet_of(scene.layers[0].gaussians) * np.float32(0.5))
    write_scene(darker, folder, known)
    assert [path.name[:8] + path.suffix for path in before if not path.exists()] == ["000-road.npy"]
    assert_same(read_scene(folder), darker)
    first_file(folder).write_bytes(b"somebody else's")
    write_scene(darker, folder, known)
    assert_same(read_scene(folder), darker)
    write_scene(darker.with_member("layers/c", wet_sh=None), folder, known)
    assert len(list(folder.rglob("*.wet.npy"))) == 1
    doubled = replace(darker, layers=(*darker.layers, replace(darker.layers[0], name="copy")))
    for _ in range(2):  # a file for each, though the Gaussians are the same
        write_scene(doubled, folder, known)
        assert_same(read_scene(folder), doubled)


@pytest.mark.parametrize("has_links", [True, False])
def test_a_copy_is_linked_or_on_a_disk_without_links_copied(
    has_links: bool, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    known = FileCache()
    scene = read_scene(folder, known)
    if not has_links:
        monkeypatch.setattr(os, "link", refused)
    write_scene_folder(scene, tmp_path / "copy", known, linking=True)
    for file in (path for path in bytes_in(folder) if path.name != "scene.json"):
        copy = tmp_path / "copy" / file.relative_to(folder)
        assert copy.read_bytes() == file.read_bytes() and copy.samefile(file) == has_links


def test_remains_of_a_killed_autosave_are_not_written_through(folder: Path, tmp_path: Path) -> None:
    """Its unfinished file may be another name of one that is whole."""
    known = FileCache()
    scene = read_scene(folder, known)
    before = bytes_in(folder)
    other = next((folder / "layers").glob("001-*.ply"))
    write_scene_folder(replace(scene, layers=(), selections={}), tmp_path / "kept")
    (tmp_path / "kept/layers").mkdir(exist_ok=True)
    os.link(other, tmp_path / "kept/layers/.000-road-kerb.part")
    write_scene_folder(scene, tmp_path / "kept", known, linking=True)
    assert bytes_in(folder) == before
    assert_same(read_scene(tmp_path / "kept"), scene)


# Links


@pytest.fixture
def far(folder: Path, tmp_path: Path) -> Path:
    """The file of the first layer, moved elsewhere; a link stands in its place."""
    file = first_file(folder)
    far = tmp_path / "another disk" / "big.ply"
    far.parent.mkdir()
    shutil.move(file, far)
    file.symlink_to(far)
    return far


def test_a_linked_file_is_read_and_stays_when_the_link_is_replaced(folder: Path, far: Path, tmp_path: Path) -> None:
    known = FileCache()
    scene = read_scene(folder, known)
    assert_same(scene, sample_scene())
    before = far.read_bytes()
    write_scene(replace(scene, name="renamed"), folder, known)
    assert first_file(folder).resolve() == far  # what has not changed stays a link
    write_scene_folder(scene, tmp_path / "kept", known, linking=True)
    road = Layer("road & kerb", sample_gaussians(9, seed=4))
    write_scene(replace(scene, layers=(road, scene.layers[1]), selections={}), folder)
    assert far.read_bytes() == before
    assert not [file for file in (folder / "layers").iterdir() if file.is_symlink()]  # the link itself went
    assert len(read_scene(folder).layers[0].gaussians) == 9
    shutil.rmtree(folder)
    assert_same(read_scene(tmp_path / "kept"), scene)  # an autosave does not depend on the link
    assert not [file for file in (tmp_path / "kept").rglob("*") if file.is_symlink()]


def test_scenes_that_share_a_linked_folder_leave_each_others_files(folder: Path, tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    shutil.move(folder / "layers", shared)
    (folder / "layers").symlink_to(shared)
    before = {file.name for file in shared.iterdir()}
    write_scene(
        replace(read_scene(folder), layers=(Layer("other", sample_gaussians(5, seed=8)),), selections={}), folder
    )
    assert before < {file.name for file in shared.iterdir()}
    assert [layer.name for layer in read_scene(folder).layers] == ["other"]


NO_FILES: list[Callable[[Path], None]] = [
    lambda file: file.symlink_to("nowhere.ply"),
    lambda file: file.symlink_to(file.name),
    os.mkfifo,
    Path.mkdir,
]


@pytest.mark.parametrize("make", NO_FILES)
def test_what_is_no_file_is_neither_read_nor_waited_for(make: Callable[[Path], None], folder: Path) -> None:
    file = first_file(folder)
    file.unlink()
    make(file)
    with pytest.raises(SceneFormatError, match=rf"scene\.json: there is no file 'layers/{file.name}'"):
        read_scene(folder)
