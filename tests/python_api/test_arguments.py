"""Arguments of the Python API: values of other libraries are taken, anything else is refused in a sentence."""

import inspect
from contextlib import contextmanager
from dataclasses import fields, replace
from fractions import Fraction
from functools import partial, wraps
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

import gsrain as gr
import type_checker
from gsrain.arguments import checked, conform
from gsrain_engine.editor.viewport.camera import home_camera
from gsrain_engine.scene.scene import PoseTrack
from small_scene import small_scene

SIZE = (8, 6)


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def camera(scene):
    return home_camera(scene, *SIZE)


@pytest.fixture
def unchecked(monkeypatch):
    """The engine without the type checks of tests, as users have it."""
    monkeypatch.setattr(type_checker, "CHECKED_CALLS", 0)


class Whole:
    """Whole number of another library."""

    def __index__(self):
        return 2


class Place:
    """Path of another library."""

    def __init__(self, path):
        self.path = path

    def __fspath__(self):
        return str(self.path)


NUMBERS = [np.float64(2), np.float32(2), np.int64(2), np.array(2.0), np.array(2), torch.tensor(2.0), torch.tensor(2),
           Fraction(2), Whole(), 2]  # fmt: skip
WHOLE = [np.int64(2), np.uint8(2), np.array(2), torch.tensor(2), Whole(), 2]
TRUE = [np.bool_(True), np.array(True), torch.tensor(True), True]


OUTPUTS = gr.RainMeasurement, gr.View, gr.ViewerError


def public_calls():
    """Functions and methods of the API that have parameters, as (name, function), and classes by their constructor."""
    for name in gr.__all__:
        member = getattr(gr, name)
        if inspect.isfunction(member):
            yield name, member
        elif inspect.isclass(member) and member.__module__.startswith("gsrain.") and member not in OUTPUTS:
            for each, value in vars(member).items():
                setter = value.fset if isinstance(value, property) else None
                function = setter or getattr(value, "__func__", value)
                is_public = each in ("__init__", "__new__") or not each.startswith("_")
                if is_public and inspect.isfunction(function) and len(inspect.signature(function).parameters) > 1:
                    yield f"{name}.{each}", function


CALLS = dict(public_calls())


def test_all_arguments_of_the_api_are_checked():
    assert len(CALLS) > 35 and {"render", "Rain.__new__", "Viewer.rain", "CameraPath.orbit", "look_at"} <= CALLS.keys()
    assert [name for name, call in CALLS.items() if not hasattr(call, "__wrapped__")] == []


@pytest.mark.parametrize("number", NUMBERS, ids=lambda each: type(each).__name__)
def test_a_number_of_any_library_is_a_number(number, scene):
    rain = gr.Rain(number, wind_speed_m_s=number)
    assert type(rain.intensity_mm_h) is type(rain.wind_speed_m_s) is float and rain == gr.Rain(2, wind_speed_m_s=2)
    assert gr.CameraPath.orbit(scene, number).duration_s == 2
    assert gr.measure_rain(gr.RainSettings(intensity_mm_h=number), number).drops > 0
    pair = [gr.render(scene, rain, size=SIZE, time=each, backend="cpu").rgb for each in (number, 2.0)]
    assert np.array_equal(*pair)


@pytest.mark.parametrize("number", WHOLE, ids=lambda each: type(each).__name__)
def test_a_whole_number_of_any_library_is_one(number):
    assert gr.Rain(seed=number) == gr.Rain(seed=2)
    with pytest.raises(ValueError, match="seed"):
        gr.Rain(seed=2.5)


@pytest.mark.parametrize("true", TRUE, ids=lambda each: type(each).__name__)
def test_a_truth_value_of_any_library_is_one(true, scene):
    assert gr.Rain(1, streaks=true) == gr.Rain(1, streaks=True)
    assert gr.render(scene, size=SIZE, depth=true, backend="cpu").depth.shape == SIZE[::-1]


@pytest.mark.parametrize("size", [np.array(SIZE), list(SIZE), torch.tensor(SIZE), tuple(map(np.int64, SIZE))], ids=str)
def test_a_size_is_any_sequence_of_two(size, scene):
    assert gr.render(scene, size=size, backend="cpu").rgb.shape == (6, 8, 3)
    assert gr.home_camera(scene, size).width == 8


def test_a_path_of_any_library_is_a_path(scene, tmp_path):
    for name in ("scene.ply", "folder"):
        gr.save(scene, Place(tmp_path / name))
        assert gr.load(Place(tmp_path / name)).gaussian_count
    gr.CameraPath.orbit(scene).save(Place(tmp_path / "path.json"), scene)
    assert gr.CameraPath.read(Place(tmp_path / "path.json"), scene).end_s > 0
    (tmp_path / "own.yaml").write_text("intensity_mm_h: 3\n")
    assert gr.Rain.preset(Place(tmp_path / "own.yaml")).intensity_mm_h == 3
    with pytest.raises(ValueError, match=r"own\.yaml"):
        gr.drive(scene, agent=Place(tmp_path / "own.yaml"))
    with pytest.raises(ValueError, match=r"own\.yaml"):
        gr.drive(scene, scenario=Place(tmp_path / "own.yaml"))


def test_arrays_of_any_library_become_gaussians_and_cameras(scene, camera, unchecked):
    g = scene.layers[0].gaussians
    for convert in (torch.from_numpy, np.float64, np.ndarray.tolist):
        made = gr.Gaussians(*map(convert, g.arrays))
        assert all(np.array_equal(a, b) and a.dtype == b.dtype for a, b in zip(made.arrays, g.arrays, strict=True))
        pose = convert(camera.world_to_camera)
        shown = gr.render(scene, camera=replace(camera, fx=np.float32(camera.fx), world_to_camera=pose), backend="cpu")
        assert shown.rgb.std() > 0
    weights = torch.tensor(g.means, requires_grad=True)
    assert np.array_equal(gr.Gaussians(weights, *g.arrays[1:]).means, g.means)


# Arrays are checked as files are


MIRRORED = np.diag([1.0, 1, -1, 1])
BAD_CAMERAS = {
    "world_to_camera.*finite": lambda c: replace(c, world_to_camera=c.world_to_camera * np.nan),
    r"without mirroring.*OpenGL": lambda c: replace(c, world_to_camera=MIRRORED @ c.world_to_camera),
    r"shape \(3, 4\).*row 0, 0, 0, 1": lambda c: replace(c, world_to_camera=c.world_to_camera[:3]),
    "last row.*transposed": lambda c: replace(c, world_to_camera=c.world_to_camera.T),
    "without scale, not of 2": lambda c: replace(c, world_to_camera=np.diag([2.0, 2, 2, 1]) @ c.world_to_camera),
    "right angles": lambda c: replace(c, world_to_camera=np.diag([1.0, 2, 1, 1]) @ c.world_to_camera),
    "fx, fy must be above 0": lambda c: replace(c, fx=-c.fx),
    "fx, fy": lambda c: replace(c, fy=0),
    "fx .*nan.*finite number": lambda c: replace(c, fx=np.nan),
    "size 0x6": lambda c: replace(c, width=0),
    "width 'wide'.*whole number": lambda c: replace(c, width="wide"),
    "world_to_camera 'identity'.*array": lambda c: replace(c, world_to_camera="identity"),
    "exposure_s": lambda c: replace(c, exposure_s=0),
}  # fmt: skip


@pytest.mark.parametrize("words", BAD_CAMERAS)
def test_a_wrong_camera_is_refused_with_its_field(words, scene, camera, unchecked):
    with pytest.raises(ValueError, match=f"^camera: .*{words}") as raised:
        gr.render(scene, camera=BAD_CAMERAS[words](camera), backend="cpu")
    assert "\n" not in str(raised.value)


def test_axes_of_opengl_get_a_warning(scene, camera):
    flipped = replace(camera, world_to_camera=np.diag([1.0, -1, -1, 1]) @ camera.world_to_camera)
    with pytest.warns(UserWarning, match=r"camera: .*upside down.*OpenGL"):
        gr.render(scene, camera=flipped, backend="cpu")


def changed(field, change):
    def make(g):
        values = getattr(g, field).copy()
        change(values)
        return replace(g, **{field: values})

    return make


BAD_GAUSSIANS = {
    r"means\[3, 1\] is nan": changed("means", lambda a: a.__setitem__((3, 1), np.nan)),
    r"sh\[2, 0, 0\] is inf": changed("sh", lambda a: a.__setitem__((2, 0, 0), np.inf)),
    r"scales\[0, 0\] is -.*np\.exp": changed("scales", lambda a: np.log(a, out=a)),
    r"opacities\[0\] is 2\.9.*np\.exp": changed("opacities", lambda a: a.__setitem__(slice(None), 2.94)),
    r"quaternions\[5\] has the length 0": changed("quaternions", lambda a: a.__setitem__(5, 0)),
    r"quaternions\[0\] has the length 3": changed("quaternions", lambda a: a.__imul__(3)),
}


@pytest.mark.parametrize("words", BAD_GAUSSIANS)
def test_wrong_gaussians_are_refused_with_layer_and_field(words, scene):
    wall = replace(scene.layers[1], gaussians=BAD_GAUSSIANS[words](scene.layers[1].gaussians))
    bad = replace(scene, layers=(scene.layers[0], wall))
    with pytest.raises(ValueError, match=f"^scene: layers.*'wall'.*{words}"):
        gr.render(bad, size=SIZE, backend="cpu")
    with pytest.raises(ValueError, match=words):
        gr.save(bad, "nowhere.ply")
    assert conform(scene, gr.Scene, "scene") is scene  # what is sound stays itself, so that it is uploaded once


# Wrong kinds


WRONG = [
    "text", "", b"bytes", -1.5, 0, 5, 1e400, np.nan, float("-inf"), 3j, 10**400, True, [], ["a"], [1, 2, 3], (8, 6, 4),
    {}, {"a": 1}, {1}, range(2), object(), int, gr.Rain, lambda: None, Path("none.json"), np.datetime64("now"),
    np.zeros(3), np.zeros((4, 4)), np.array(["a"]), np.array([None]), torch.zeros(2, 2),
]  # fmt: skip
CHEAP = {
    "load": {"path": "none.ply"},
    "save": {"scene": None, "path": "new.ply"},
    "home_camera": {"scene": None},
    "view": {"scene": None, "name": "none"},
    "edit": {"scene": None, "name": "rename", "key": "layers/road", "to": "asphalt"},
    "capture": {"path": "none"},
    "render": {"scene": None, "size": SIZE, "backend": "cpu"},
    "frames": {"scene": None, "size": SIZE, "backend": "cpu"},
    "look_at": {"eye": [0, 0, 0], "target": [1, 0, 0], "up": [0, 0, 1]},
    "sh_from_color": {"colors": [[0, 0, 0]]},
    "load_scenario": {"name": "stationary-lead"},
    "read_rollout": {"path": "none.jsonl"},
    "measure_rain": {"rain": gr.Rain(1), "seconds": 1},
    "Rain.__new__": {},
    "Rain.preset": {"name": "clear"},
    "CameraPath.through": {"times_s": [0, 1], "cameras": []},
    "CameraPath.orbit": {"scene": None},
    "CameraPath.default": {"scene": None},
}
"""Calls that are made whole with a wrong argument; those of the others, which may take long, end when it is taken."""


@pytest.mark.parametrize("name", CALLS)
def test_a_wrong_kind_of_argument_gets_one_sentence(name, scene, tmp_path, monkeypatch, unchecked):
    monkeypatch.chdir(tmp_path)
    call, own = CALLS[name], inspect.signature(CALLS[name]).parameters
    if name not in CHEAP:
        call = checked(wraps(call.__wrapped__)(lambda *args, **kwargs: None))
    if owner := {"self", "cls"} & own.keys():
        call = partial(call, getattr(gr, name.partition(".")[0]))
    named = {each: p for each, p in own.items() if each not in owner and p.kind is not p.VAR_KEYWORD}
    given = dict.fromkeys((each for each, p in named.items() if p.default is p.empty), scene) | CHEAP.get(name, {})
    given = {each: scene if value is None else value for each, value in given.items()}
    first = [each for each, p in named.items() if p.kind is p.POSITIONAL_ONLY]
    refused = 0
    for argument in dict.fromkeys([*named, *given, "unknown_argument"]):
        for wrong in WRONG:
            arguments = given | {argument: wrong}
            with refusal(argument, wrong) as refusals:
                call(*map(arguments.pop, first), **arguments)
            refused += len(refusals)
    assert refused > len(WRONG)


@contextmanager
def refusal(*of):
    """Let a block raise what the API raises for bad arguments, in one line; yields a list of the errors."""
    refusals = []
    try:
        yield refusals
    except (ValueError, TypeError, OSError) as error:
        refusals.append(error)
        assert "\n" not in str(error) and len(str(error)) < 2000, of


@pytest.mark.parametrize("kind", ["camera", "gaussians", "layer", "actor", "lamp", "view", "scene", "rain", "path"])
def test_a_value_with_a_wrong_kind_of_field_is_refused_where_it_is_used(kind, scene, camera, unchecked):
    layer = scene.layers[0]
    track = PoseTrack(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones(1, bool))
    actor = gr.Actor("one", "car", (4.0, 2.0, 1.5), layer.gaussians, track)
    value, use = {
        "camera": (camera, lambda made: gr.render(scene, camera=made, backend="cpu")),
        "gaussians": (layer.gaussians, lambda made: rendered(replace(layer, gaussians=made))),
        "layer": (layer, rendered),
        "actor": (actor, lambda made: conform(replace(scene, actors=(made,)), gr.Scene, "scene")),
        "lamp": (gr.Lamp(position=(0, 0, 3)), lambda made: conform(replace(scene, lamps=(made,)), gr.Scene, "scene")),
        "view": (
            gr.NamedView(name="one", position=(0, 0, 3), quaternion_wxyz=(1, 0, 0, 0)),
            lambda made: conform(replace(scene, views=(made,)), gr.Scene, "scene"),
        ),
        "scene": (scene, lambda made: conform(made, gr.Scene, "scene")),
        "rain": (gr.Rain(1), lambda made: conform(made, gr.RainSettings, "rain")),
        "path": (gr.CameraPath.orbit(scene), lambda made: conform(made, gr.CameraPath, "path").camera(0.0, *SIZE)),
    }[kind]
    is_struct = isinstance(value, msgspec.Struct)
    make = msgspec.structs.replace if is_struct else replace
    names = value.__struct_fields__ if is_struct else [each.name for each in fields(value)]
    refused = 0
    for name in names:
        for wrong in WRONG:
            if is_struct and isinstance(wrong, torch.Tensor | int):
                continue  # the checks in structs compare tensors, and print too large numbers
            with refusal(name, wrong) as refusals:
                use(make(value, **{name: wrong}))
            refused += len(refusals)
    assert refused > len(names)


def rendered(layer):
    """Image of one layer."""
    return gr.render(gr.Scene("one", (layer,)), size=SIZE, backend="cpu")
