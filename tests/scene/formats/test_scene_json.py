"""Descriptions of scenes: older ones are read; damaged ones, and values that could not be read back, are refused."""

import base64
import json
import os
import re
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.flags import UNMARKED, BitMask
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.formats.scene_json import mask_from_text, mask_to_text, record_of
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import UNCHANGED, Layer, Scene

from .sample_files import sample_gaussians
from .test_scene_folder import assert_same, bytes_in, sample_scene, track
from .test_scene_folder import folder as folder  # a fixture

Values = dict[str, Any]


def edit(folder: Path, change: Callable[[Values], Any]) -> None:
    values = json.loads((folder / "scene.json").read_text())
    change(values)
    (folder / "scene.json").write_text(json.dumps(values))


def refusal(folder: Path) -> str:
    with pytest.raises(SceneFormatError) as error:
        read_scene(folder)
    assert "\n" not in str(error.value)
    return str(error.value)


# Versions


@pytest.mark.parametrize("version", [0, 1, 2, 3, 4, 8])
def test_older_versions_lack_fields(version: int, folder: Path) -> None:
    since = {
        8: (("views",), ()),
        4: (("lamps",), ()),
        3: (("in_drawing_order", "weather"), ()),
        2: ((), ("wet_file",)),
        1: (("path", "view", "selections"), ("locked", "opacity", "grading", "marks", "to_scene")),
        0: (("rain", "rigs", "ego", "actors", "ground_m", "metres_per_unit", "up"), ("kind", "visible")),
    }

    def older(values: Values) -> None:
        for own, of_members in (fields for number, fields in since.items() if number >= version):
            for name in own:
                del values[name]
            for member in (*values["layers"], *values.get("actors", ())):
                for name in of_members:
                    member.pop(name, None)
        values["version"] = version

    edit(folder, older)
    found, expected = read_scene(folder), replace(sample_scene(), views=())
    if version < 8:
        expected = replace(expected, lamps=())
    if version < 4:
        expected = replace(expected, weather=None)
    if version < 3:
        expected = expected.with_member(expected.layers[0].key, wet_sh=None)
        expected = expected.with_member("actors/lead/1", wet_sh=None)
    if version < 2:
        bare = {"locked": False, "opacity": 1.0, "grading": UNCHANGED, "marks": UNMARKED}
        for member in expected.members:
            expected = expected.with_member(member.key, **bare)
        expected = replace(expected, path=None, view=None, selections={})
    if version == 0:
        layers = tuple(Layer(each.name, each.gaussians) for each in expected.layers)
        expected = Scene(expected.name, layers)
    assert_same(found, expected)


def test_a_newer_version_is_neither_read_nor_replaced_but_a_damaged_scene_may_be(folder: Path) -> None:
    edit(folder, lambda values: values.update(version=10, new_field=True))
    assert "version 10 is of a newer program" in refusal(folder)
    before = bytes_in(folder)
    with pytest.raises(SceneFormatError, match="newer program"):
        write_scene(sample_scene(), folder)
    assert bytes_in(folder) == before
    edit(folder, lambda values: values.update(version=5, up="left"))
    write_scene(sample_scene(), folder)
    assert read_scene(folder).up == (0.1, -0.9, 0.2)


# Masks


def test_a_million_marks_take_little_room() -> None:
    flags = np.random.default_rng(0).random(1_000_000) < 0.5
    text = mask_to_text(BitMask.of(flags))
    assert len(text) < 170_000  # chance can't be compressed: a bit and a third a Gaussian
    assert np.array_equal(mask_from_text(text, 1_000_000, "here").flags, flags)
    assert len(mask_to_text(BitMask.of(np.arange(1_000_000) < 300_000))) < 1_000


def test_selections_of_members_that_changed_are_dropped() -> None:
    sets = {"x": {"layers/sky": BitMask.all(20), "layers/road & kerb": BitMask.all(7), "layers/gone": BitMask.all(7)}}
    scene = replace(sample_scene(), selections=sets)
    assert set(record_of(scene, ["a", "b", "c"]).selections["x"]) == {"layers/sky"}


# Values that are wrong


def put(value: object, *place: Any) -> Callable[[Values], None]:
    """Set a value deep inside of the description."""
    *way, last = place

    def change(values: Any) -> None:
        for step in way:
            values = values[step]
        values[last] = value

    return change


def mark(name: str, text: str) -> Callable[[Values], None]:
    return put(text, "layers", 0, "marks", name)


def camera(row: int, values: list[float]) -> Callable[[Values], None]:
    return put(values, "rigs", "waymo", 1, "camera_to_ego", row)


def file_of(number: int, name: str = "file") -> Callable[[Values], str]:
    return lambda values: values["layers"][number][name]


_LONG = base64.b64encode(zlib.compress(bytes(1 << 24))).decode()
_IS_NO_POSE = "camera_to_ego of camera 'LEFT'"

BAD_VALUES: list[tuple[Callable[[Values], Any], str]] = [
    (put("red", "color"), "unknown field `color`"),
    (put("red", "layers", 0, "marks", "color"), "`$.layers[0].marks`"),
    (put("red", "actors", 0, "track", "color"), "`$.actors[0].track`"),
    (put("red", "path", "keyframes", 0, "color"), "`$.path.keyframes[0]`"),
    (put("red", "views", 0, "color"), "`$.views[0]`"),
    (put("back", "views", 0, "name"), "two views named 'back' - at `$.views[1]`"),
    (put("", "views", 0, "name"), "printable characters, without spaces at its ends - at `$.views[0]`"),
    (put("a\nb", "views", 1, "name"), "printable characters, without spaces at its ends - at `$.views[1]`"),
    (put([0, 0, 0, 0], "views", 1, "quaternion_wxyz"), "must have the length 1 - at `$.views[1]`"),
    (put([0, 0, 1e200], "views", 1, "position"), "must be finite numbers - at `$.views[1]`"),
    (put(180, "views", 1, "vertical_fov_deg"), "`$.views[1].vertical_fov_deg`"),
    (put("no base64", "views", 1, "picture"), "`$.views[1].picture`"),
    (put("A" * 100_000, "views", 1, "picture"), "`$.views[1].picture`"),
    (lambda v: v.pop("version"), "`version`"),
    (put("3", "metres_per_unit"), "Expected a number, got text - at `$.metres_per_unit`"),
    (put([0, 0, 0], "up"), "`$.up`"),
    (put([1e200, 0, 0], "up"), "`$.up`"),
    (put("ocean", "layers", 1, "kind"), "'ocean', expected background, sky - at `$.layers[1].kind`"),
    (put(1.1, "layers", 1, "opacity"), "`$.layers[1].opacity`"),
    (put(0.5, "layers", 1, "to_scene", 0, 1), "`$.layers[1].to_scene`"),  # sheared
    (put(-1.0, "layers", 1, "to_scene", 0, 0), "`$.layers[1].to_scene`"),  # mirrored
    (lambda v: v["actors"][0]["track"]["times"].pop(), "`$.actors[0].track`"),
    (put([0, 1, 1], "ego", "times"), "times must rise - at `$.ego`"),
    (put([0, 0, 0, 0], "ego", "quaternions_wxyz", 0), "quaternion 0"),
    (put([1e200, 0, 0, 0], "actors", 0, "track", "quaternions_wxyz", 2), "quaternion 2"),
    (put(16385, "rigs", "waymo", 0, "height"), "`$.rigs[...][0].height`"),
    (put(180, "path", "keyframes", 0, "vertical_fov_deg"), "`$.path.keyframes[0].vertical_fov_deg`"),
    (camera(0, [1e200, -1e200, 1e200, 0]), _IS_NO_POSE),
    (camera(1, [0, 0, 1, 0]), _IS_NO_POSE),
    (put({"keyframes": []}, "path"), "`$.path.keyframes`"),
    (put(0.0, "path", "keyframes", 1, "time_s"), "times must rise - at `$.path`"),
    (mark("selected", "?"), "no mask can be read"),
    (mark("deleted", mask_to_text(BitMask.all(50))[:-8]), "cut off - at `$.layers[0].marks.deleted`"),
    (mark("deleted", mask_to_text(BitMask.all(32))), "a mask of 50 Gaussians takes 8 bytes, this one has 4"),
    (mark("deleted", _LONG), "this one has more than 8 - at `$.layers[0].marks.deleted`"),
    (mark("deleted", mask_to_text(BitMask.all(64))), "beyond the 50"),
    (put({"x": {"layers/c": ""}}, "selections"), "'layers/c'"),
    (put("layers/none.ply", "layers", 0, "file"), "'layers/none.ply'"),
    (put("../outside.ply", "layers", 0, "file"), "'../outside.ply' must lie inside"),
    (put("/etc/passwd", "layers", 0, "file"), "'/etc/passwd' must lie inside"),
    (put("a\0b", "layers", 0, "file"), "'a\\x00b'"),
    (put("scene.json", "layers", 0, "file"), "no known scene format"),
    (lambda v: put(file_of(1)(v), "layers", 0, "file")(v), "must belong to one layer or actor"),
    (lambda v: put(file_of(0)(v), "layers", 0, "wet_file")(v), "must belong to one layer or actor"),
    (put("../x.wet.npy", "layers", 0, "wet_file"), "'../x.wet.npy' must lie inside"),
    (put("layers/gone.wet.npy", "layers", 0, "wet_file"), "'layers/gone.wet.npy'"),
    *((put(name, "layers", 0, "file"), "scene.json: ")
      for name in ("x" * 300 + ".ply", "layers/\u00e9\u2028.ply", ".", "layers", "layers/../scene.json/x.ply")),
]  # fmt: skip


@pytest.mark.parametrize(("change", "field"), BAD_VALUES, ids=[field for _, field in BAD_VALUES])
def test_bad_values_are_named(change: Callable[[Values], Any], field: str, folder: Path) -> None:
    (folder.parent / "outside.ply").write_bytes(next(folder.rglob("*.ply")).read_bytes())
    edit(folder, change)
    assert field in refusal(folder)


@pytest.mark.parametrize("text", ["", "{", "null", "[]", '{"version": 1e999}', '{"version": NaN}', "\xff", "[" * 10**6])
def test_what_is_no_json_is_refused(text: str, folder: Path) -> None:
    (folder / "scene.json").write_bytes(text.encode("latin-1"))
    assert "scene.json: not the description of a scene" in refusal(folder)


def test_deep_and_endless_descriptions_are_refused(folder: Path) -> None:
    data = (folder / "scene.json").read_text()
    nested = '"rain": {"a": ' + "[" * 200_000 + "]" * 200_000 + '},\n "weather"'
    (folder / "scene.json").write_text(re.sub(r'"rain": \{.*\},\s+"weather"', nested, data, flags=re.DOTALL))
    assert "recursion" in refusal(folder)
    os.truncate(folder / "scene.json", 2**26 + 1)
    assert "larger than 67 MB" in refusal(folder)


def cut(data: bytes) -> bytes:
    return data[:-4]


DAMAGED_WET_FILES: list[tuple[Callable[[bytes], bytes], str]] = [
    (lambda data: b"", "no array file of wet colors"),
    (cut, "does not end after the 600 bytes"),
    (lambda data: data + b"\0", "does not end after the 600 bytes"),
    (lambda data: data.replace(b"<f4", b"<i4"), "int32 (50, 1, 3), expected float32 (50, 1, 3)"),
    (lambda data: data.replace(b"'<f4'", b"'|O' "), "holds object"),
    (lambda data: data.replace(b"False", b"True "), "in Fortran's order"),
    (lambda data: data.replace(b"(50, 1, 3)", b"(1, 50, 3)"), "(1, 50, 3), expected"),
    (lambda data: data.replace(b"(50, 1, 3)", b"(9**40, 1)"), "no array file of wet colors"),
    (lambda data: cut(data) + np.float32(np.inf).tobytes(), "a wet color that is not a finite number"),
]


@pytest.mark.parametrize(("damage", "field"), [(cut, "cut off"), *DAMAGED_WET_FILES])
def test_a_damaged_file_is_named_itself(damage: Callable[[bytes], bytes], field: str, folder: Path) -> None:
    suffix = "ply" if field == "cut off" else "wet.npy"
    (path,) = (folder / "layers").glob(f"000-*.{suffix}")
    path.write_bytes(damage(path.read_bytes()))
    assert refusal(folder).startswith(f"{path}: ") and field in refusal(folder)


# Values that could not be read back


def with_nan(sh: bool) -> dict[str, Any]:
    some = sample_gaussians(4)
    means, wet = some.means.copy(), some.sh.copy()
    (wet if sh else means)[1, 2] = np.nan
    bad = Gaussians(some.means if sh else means, some.scales, some.quaternions, some.opacities, some.sh)
    return {"layers": (Layer("a", sample_gaussians(2)), Layer("b", bad, wet_sh=wet if sh else None)), "selections": {}}


NAN = float("nan")
UNREADABLE: list[tuple[dict[str, Any], str]] = [
    ({"metres_per_unit": 0.0}, "`$.metres_per_unit`"),
    ({"up": (0.0, 0.0, 0.0)}, "`$.up`"),
    ({"ground_m": NAN}, "`$.ground_m`"),
    ({"rain": {"a": [0.5, {"b": -np.inf}]}}, "`$.rain.a[1].b`"),
    ({"ego": replace(track(3), times=np.array([0.0, 2, 1]))}, "times must rise - at `$.ego`"),
    ({"ego": replace(track(3), positions=np.full((3, 3), NAN))}, "`$.ego.positions["),
    ({"name": "\ud800"}, "'utf-8' codec"),
    (with_nan(False), "1 of 4 Gaussians have a mean of layer 'b'"),
    (with_nan(True), "1 of 4 Gaussians have a wet color of layer 'b'"),
]


@pytest.mark.parametrize(("changes", "field"), UNREADABLE, ids=[field for _, field in UNREADABLE])
def test_a_scene_that_could_not_be_read_back_replaces_nothing(
    changes: dict[str, Any], field: str, folder: Path
) -> None:
    before = bytes_in(folder.parent)
    for place in (folder, folder.parent / "new"):
        with pytest.raises(SceneFormatError, match=re.escape(field)) as error:
            write_scene(replace(sample_scene(), **changes), place)
        assert str(error.value).startswith(str(place)) and "\n" not in str(error.value)
    assert bytes_in(folder.parent) == before
