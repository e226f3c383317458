"""Additions of version 2 of scene folders: marks, grading, placement, paths, selections; version 1 is still read."""

import base64
import json
import zlib
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.flags import UNMARKED, BitMask, SelectionFlags
from gsrain_engine.scene.formats import scene_folder
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.formats.scene_folder import FileCache
from gsrain_engine.scene.formats.scene_json import SceneRecord, mask_from_text, mask_to_text, record_of, scene_of
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.geometry import matrices_from_quaternions, normalized
from gsrain_engine.scene.scene import UNCHANGED, Actor, ColorGrading, Layer, PoseTrack, Scene

from .sample_gaussians import assert_equal, sample_gaussians

NUMBERS = st.floats(-1e6, 1e6, width=32)


BITS = st.none() | st.integers(1, 2**70 - 1)
"""A mask: Gaussian n is meant where bit n is set."""
ROTATION = st.tuples(*[st.floats(0.1, 1)] * 4)
PLACE = st.tuples(NUMBERS, NUMBERS, NUMBERS)
SHOWN = st.fixed_dictionaries(
    {
        "visible": st.booleans(),
        "locked": st.booleans(),
        "opacity": st.floats(0, 1),
        "grading": st.fixed_dictionaries({"exposure_ev": st.floats(-6, 6), "saturation": st.floats(0, 3)}),
        "marks": st.tuples(BITS, BITS, BITS),
    }
)
LAYER = st.tuples(
    st.text(max_size=5), st.sampled_from([0, 1, 31, 32, 33, 70]), st.floats(1e-3, 1e3), ROTATION, PLACE, SHOWN
)
KEY = st.tuples(st.floats(0.1, 10), PLACE, ROTATION, st.floats(1, 170))
PATH = st.tuples(
    st.lists(KEY, min_size=1, max_size=4),
    st.floats(1e-4, 1),
    st.sampled_from(["spline", "linear"]),
    st.sampled_from(["none", "in and out", "at each key"]),
    st.booleans(),
)
PLANS = st.fixed_dictionaries(
    {
        "layers": st.lists(LAYER, max_size=3),
        "actor": SHOWN,
        "path": st.none() | PATH,
        "weather": st.none() | st.dictionaries(st.text(), NUMBERS),
        "view": st.none() | st.dictionaries(st.text(), st.text()),
        "selections": st.dictionaries(st.text(max_size=4), BITS, max_size=2),
    }
)


def mask(bits: int | None, count: int) -> BitMask | None:
    flags = np.array([bits is not None and bits >> n & 1 == 1 for n in range(count)], np.bool_)
    return BitMask.of(flags) if flags.any() else None


def shown(plan: dict[str, Any], count: int) -> dict[str, Any]:
    marks = SelectionFlags(*(mask(bits, count) for bits in plan["marks"]))
    return plan | {"grading": ColorGrading(**plan["grading"]), "marks": marks}


def unit(values: Any) -> np.ndarray:
    return normalized(np.array(values, np.float64).reshape(-1, 4))


def scene_of_plan(plan: dict[str, Any]) -> Scene:
    layers: list[Layer] = []
    for n, (name, count, scale, turn, place, shows) in enumerate(plan["layers"]):
        placed = np.eye(4)
        placed[:3, :3] = scale * matrices_from_quaternions(unit(turn)[0])
        placed[:3, 3] = place
        layers.append(Layer(f"{name}{n}", sample_gaussians(count, seed=n), "sky", placed, **shown(shows, count)))
    track = PoseTrack(np.arange(2.0), np.zeros((2, 3)), unit([[1, 2, 3, 4], [1, 0, 0, 0]]), np.array([True, False]))
    actor = Actor("car", "car", (4.0, 2.0, 1.0), sample_gaussians(9), track, **shown(plan["actor"], 9))
    path = None
    if plan["path"] is not None:
        keys, *rest = plan["path"]
        steps, places, turns, fov = (np.array(each, np.float64) for each in zip(*keys, strict=True))
        path = CameraPath(np.cumsum(steps), places, unit(turns), fov, *rest)
    every = (*layers, actor)
    sets = {
        name: {each.key: meant for each in every if (meant := mask(bits, len(each.gaussians))) is not None}
        for name, bits in plan["selections"].items()
    }
    return Scene("s", tuple(layers), (actor,), path=path, weather=plan["weather"], view=plan["view"], selections=sets)


def same_mask(a: BitMask | None, b: BitMask | None) -> bool:
    return a is b or (a is not None and b is not None and a.same_as(b))


def assert_same(found: Scene, expected: Scene) -> None:
    assert (found.weather, found.view) == (expected.weather, expected.view)
    for a, b in zip(found.members, expected.members, strict=True):
        assert (a.key, a.visible, a.locked, a.opacity, a.grading) == (
            b.key, b.visible, b.locked, b.opacity, b.grading,
        )  # fmt: skip
        assert_equal(a.gaussians, b.gaussians)
        assert np.array_equal(a.pose_at(0.0), b.pose_at(0.0))
        for name in ("selected", "hidden", "deleted"):
            assert same_mask(getattr(a.marks, name), getattr(b.marks, name))
    assert (found.path is None) == (expected.path is None)
    if found.path is not None and expected.path is not None:
        for field in fields(CameraPath):
            assert np.array_equal(getattr(found.path, field.name), getattr(expected.path, field.name)), field.name
    assert found.selections.keys() == expected.selections.keys()
    for name, sets in expected.selections.items():
        assert found.selections[name].keys() == sets.keys()
        assert all(mask.same_as(found.selections[name][key]) for key, mask in sets.items())


@settings(max_examples=30)
@given(PLANS)
def test_everything_comes_back(tmp_path_factory: pytest.TempPathFactory, plan: dict[str, Any]) -> None:
    scene = scene_of_plan(plan)
    folder = tmp_path_factory.mktemp("scene") / "saved"
    write_scene(scene, folder)
    assert_same(read_scene(folder), scene)


def two_layers() -> Scene:
    marks = SelectionFlags(selected=BitMask.of(np.arange(50) % 2 == 0), deleted=BitMask.of(np.arange(50) > 30))
    return Scene("two", (Layer("a", sample_gaussians(50, 0), marks=marks), Layer("b", sample_gaussians(40, 1))))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_scene(two_layers(), tmp_path / "saved")
    return tmp_path / "saved"


def edit(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    values = json.loads((folder / "scene.json").read_text())
    change(values)
    (folder / "scene.json").write_text(json.dumps(values))


def test_version_1_reads(folder: Path) -> None:
    def older(values: dict[str, Any]) -> None:
        for name in ("path", "weather", "view", "selections", "in_drawing_order"):
            del values[name]
        for layer in values["layers"]:
            for name in ("locked", "opacity", "grading", "marks", "to_scene"):
                del layer[name]
        values["version"] = 1

    edit(folder, older)
    (first, _), scene = read_scene(folder).layers, read_scene(folder)
    assert (first.locked, first.opacity, first.grading, first.marks) == (False, 1.0, UNCHANGED, UNMARKED)
    assert np.array_equal(first.to_scene, np.eye(4))
    assert (scene.path, scene.weather, scene.view, scene.selections) == (None, None, None, {})


def test_a_million_marks_take_little_room() -> None:
    flags = np.random.default_rng(0).random(1_000_000) < 0.5
    text = mask_to_text(BitMask.of(flags))
    assert len(text) < 170_000  # chance can't be compressed: a bit and a third a Gaussian
    assert np.array_equal(mask_from_text(text, 1_000_000, "here").flags, flags)
    assert len(mask_to_text(BitMask.of(np.arange(1_000_000) < 300_000))) < 1_000


LONG = base64.b64encode(zlib.compress(bytes(1 << 24))).decode()


def first_marks(**marks: str) -> Callable[[dict[str, Any]], None]:
    return lambda values: values["layers"][0]["marks"].update(marks)


def second(field: str, *path: Any) -> Callable[[dict[str, Any]], None]:
    """Set what the second layer's field, or something deep in it, is."""
    *way, last, value = (field, *path)

    def change(values: dict[str, Any]) -> None:
        place = values["layers"][1]
        for step in way:
            place = place[step]
        place[last] = value

    return change


BAD: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "no base64": (first_marks(selected="?"), "no mask can be read"),
    "no stream": (first_marks(hidden="AAAA"), "no mask can be read"),
    "cut off": (
        first_marks(deleted=mask_to_text(BitMask.all(50))[:-8]),
        "the mask is cut off - at `$.layers[0].marks.deleted`",
    ),
    "too short": (
        first_marks(deleted=mask_to_text(BitMask.all(32))),
        "a mask of 50 Gaussians takes 8 bytes, this one has 4",
    ),
    "too long": (first_marks(deleted=LONG), "this one has more than 8 - at `$.layers[0].marks.deleted`"),
    "beyond the end": (first_marks(deleted=mask_to_text(BitMask.all(64))), "Gaussians beyond the 50 that there are"),
    "opacity": (second("opacity", 1.5), "Expected `float` <= 1.0 - at `$.layers[1].opacity`"),
    "grading": (second("grading", "contrast", 9), "<= 3.0 - at `$.layers[1].grading.contrast`"),
    "sheared": (second("to_scene", 0, 1, 0.5), "one scale above 0 and a place - at `$.layers[1].to_scene`"),
    "mirrored": (second("to_scene", 0, 0, -1.0), "one scale above 0 and a place - at `$.layers[1].to_scene`"),
    "stranger": (lambda v: v.update(selections={"x": {"layers/c": ""}}), "there is no layer or actor 'layers/c' - at"),
    "no keys": (lambda v: v.update(path={"keyframes": []}), "of length >= 1 - at `$.path.keyframes`"),
    "newer": (lambda v: v.update(version=5), "version 5 is of a newer program; this one reads versions up to 4"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_values_are_named(name: str, folder: Path) -> None:
    change, problem = BAD[name]
    edit(folder, change)
    with pytest.raises(SceneFormatError) as error:
        read_scene(folder)
    assert problem in str(error.value)
    assert "\n" not in str(error.value)


def test_what_a_selection_says_of_members_that_changed_is_dropped() -> None:
    scene = replace(two_layers(), selections={"x": {"layers/a": BitMask.all(50), "layers/gone": BitMask.all(7)}})
    kept = record_of(scene, ["a.ply", "b.ply"])
    assert set(kept.selections["x"]) == {"layers/a"}
    assert isinstance(kept, SceneRecord)
    assert scene_of(kept, [each.gaussians for each in scene.layers]).selections["x"]["layers/a"].size == 50


def test_known_gaussians_are_not_written_again(folder: Path) -> None:
    known = FileCache()
    scene = read_scene(folder, known)
    before = {path: path.stat().st_ino for path in folder.rglob("*.ply")}
    renamed = replace(scene, layers=(replace(scene.layers[1], name="c"), scene.layers[0]))
    write_scene(renamed, folder, known)
    assert {path: path.stat().st_ino for path in folder.rglob("*.ply")} == before
    assert_same(read_scene(folder), renamed)
    next(iter(before)).write_bytes(b"somebody else's")
    write_scene(renamed, folder, known)
    assert_same(read_scene(folder), renamed)


def test_a_scene_that_is_replaced_while_it_is_read_is_read_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    newer = Scene("newer", (Layer("n", sample_gaussians(7, 3)),))
    reading, read = scene_folder.read_gaussians, list[Path]()

    def replaced(path: Path) -> Gaussians:
        read.append(path)
        if len(read) == 1:
            write_scene(newer, folder)
        return reading(path)

    monkeypatch.setattr(scene_folder, "read_gaussians", replaced)
    assert_same(read_scene(folder), newer)


def test_gaussians_that_two_layers_share_are_kept_twice(folder: Path) -> None:
    known = FileCache()
    scene = read_scene(folder, known)
    doubled = replace(scene, layers=(*scene.layers, replace(scene.layers[0], name="copy")))
    for _ in range(2):
        write_scene(doubled, folder, known)
        assert_same(read_scene(folder), doubled)
    assert len(list(folder.rglob("*.ply"))) == 3
