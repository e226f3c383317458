"""Compute shaders on a GPU made of Python: threads in shuffled orders, and every access that nothing puts in order."""

from dataclasses import replace

import moderngl
import msgspec
import numpy as np
import pytest

from gsrain_engine.presets import shipped_folder
from gsrain_engine.rain.frame import RainCamera
from gsrain_engine.rain.properties import CLASSES
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.rain.shelter_map import ShelterMap
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.opengl import shaders, sort
from gsrain_engine.render.opengl.buffers import COUNT_OFFSET, GpuArrays, ProjectedSplatBuffer
from gsrain_engine.render.opengl.projection import ProjectionPass
from gsrain_engine.render.opengl.rain import RainPass, streak_slots
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.render.opengl.sort import DIGIT_BITS, KEYS_BY_GROUP, DepthSort, sort_faults
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import DrawItem
from interpreted_gpu.context import InterpretedContext

EYE = np.array([3.0, -2.0, 1.5])
CAMERA = Camera.from_fov(64, 48, 45.0, look_at(EYE, EYE + np.array([1, 0.2, 0.1]), np.array([0, 0, 1.0])))
ANCHOR = np.eye(4)
ANCHOR[:3, 3] = EYE


@pytest.fixture
def edit(monkeypatch):
    """Take text out of a shader, or put other text in its place, for this test."""
    read = shaders.read_shader

    def change(name, old, new=""):
        text = "\n".join(read(name))
        assert old in text
        texts[name] = text.replace(old, new).split("\n")

    texts = {}
    monkeypatch.setattr(shaders, "read_shader", lambda name: texts.get(name) or read(name))
    return change


def order_of(context, keys):
    """Sort on a context by the lowest digit of keys alone."""
    sorter = DepthSort(context)
    sorter.reserve(len(keys))
    for buffer, values in zip(sorter.unsorted, (keys, np.arange(len(keys), dtype=np.uint32)), strict=True):
        buffer.write(values)
    work = np.array([0, 0, 0, 0, 0, len(keys), -(-len(keys) // KEYS_BY_GROUP), 1, 1], np.uint32)
    return np.frombuffer(sorter.sort(context.buffer(work.tobytes())).read(4 * len(keys)), np.uint32)


@pytest.fixture
def one_digit(monkeypatch):
    monkeypatch.setattr(sort, "KEY_BITS", DIGIT_BITS)


def keys_of(count):
    return np.random.default_rng(count).integers(0, 1 << DIGIT_BITS, count, dtype=np.uint32)


@pytest.mark.parametrize("warps", [False, True])
@pytest.mark.parametrize("count", [700, KEYS_BY_GROUP + 300])
def test_the_sort_has_no_race_in_any_order_of_threads(one_digit, count, warps):
    context, keys = InterpretedContext(count, warps=warps), keys_of(count)
    np.testing.assert_array_equal(order_of(context, keys), np.argsort(keys, kind="stable"))
    assert list(context.faults) == []


def test_a_pass_reads_what_the_pass_before_it_wrote(monkeypatch):
    monkeypatch.setattr(sort, "KEY_BITS", 2 * DIGIT_BITS)
    context, keys = InterpretedContext(3), np.random.default_rng(3).integers(0, 256, 300, dtype=np.uint32)
    np.testing.assert_array_equal(order_of(context, keys), np.argsort(keys, kind="stable"))
    assert list(context.faults) == []


END_OF_ROUND = "            place[lane] += sum;\n        }\n        barrier();\n"


@pytest.mark.parametrize("warps", [False, True])
def test_finds_the_round_that_began_before_the_last_one_was_over(edit, one_digit, warps):
    """The shader as it was: on an H100 it lost a hundredth to a half of all splats. On llvmpipe it sorts well."""
    edit("radix_scatter.comp", END_OF_ROUND, END_OF_ROUND.replace("        barrier();\n", ""))
    context, keys = InterpretedContext(1, warps=warps), keys_of(700)
    order = order_of(context, keys)
    assert any("radix_scatter.comp:" in fault and "mask" in fault for fault in context.faults)
    check = sort_faults(keys, order, order_of(InterpretedContext(2, warps=warps), keys))
    assert check.missing > 0
    assert check.inversions > 0
    assert check.changed > 0


BARRIERS = {
    "radix_count.comp": (1, 2),
    "radix_scan.comp": (1, 2, 3),
    "radix_scatter.comp": (1, 2, 3, 4),
}


@pytest.mark.parametrize(("name", "number"), [(name, number) for name in BARRIERS for number in BARRIERS[name]])
def test_misses_each_barrier_of_the_sort(edit, one_digit, name, number):
    """Not one of them could go, and none that goes is overlooked."""
    parts = "\n".join(shaders.read_shader(name)).split("barrier();")
    assert len(parts) == len(BARRIERS[name]) + 1
    edit(name, "barrier();".join(parts), "barrier();".join(parts[:number]) + "barrier();".join(parts[number:]))
    context = InterpretedContext(number)
    order_of(context, keys_of(700))
    assert any(name in fault for fault in context.faults)


def scene(count, harmonics):
    rng = np.random.default_rng(count)
    means = rng.uniform(-2, 2, (count, 3)).astype(np.float32) + (EYE + [4, 0.8, 0.4]).astype(np.float32)
    quaternions = rng.normal(size=(count, 4)).astype(np.float32)
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    scales, opacities = (rng.uniform(0.01, 0.1, (count, 3)), rng.uniform(0, 1, count))
    sh = rng.normal(scale=0.1, size=(count, harmonics, 3)).astype(np.float32)
    return Gaussians(means, scales.astype(np.float32), quaternions, opacities.astype(np.float32), sh)


def drops_of(**changes):
    """A shower of few drops, many of which the camera may see."""
    rain = msgspec.structs.replace(load_preset("8.5"), seed=3, max_copies=2, haze=False, **changes)
    field = RainSimulation.start(rain).frame(12.3, RainCamera(CAMERA, ANCHOR, np.zeros(3)))
    culling = field.culling._replace(class_far_m=np.full(CLASSES, 30.0), slopes=np.array([-2.0, 2.0, -2.0, 2.0]))
    return replace(field, count=400, culling=culling)


def filled(context, parts, harmonics="half", rain=None, look="splats"):
    """Project and bring together as a frame does; returns keys and slots of what can be seen."""
    projection, store, sorter = (
        ProjectionPass(context, GpuArrays(context, harmonics)),
        ProjectedSplatBuffer(context),
        DepthSort(context),
    )
    slots = projection.project(store, parts, CAMERA, rain, look)
    projection.compact_visible(store, sorter, slots)
    visible = int(np.frombuffer(store.work.read(4, offset=COUNT_OFFSET), np.uint32)[0])
    return [np.frombuffer(each.read(4 * visible), np.uint32) for each in sorter.unsorted]


@pytest.mark.parametrize(
    ("harmonics", "changes", "look"),
    [
        ("half", {}, "splats"),
        ("single", {"wetness": 0.5}, "splats"),
        ("byte", {"selected": 1, "left_out": 1}, "splats"),
        ("half", {}, "normals"),
    ],
)
def test_projects_without_a_race_what_a_driver_projects(context, harmonics, changes, look):
    """Across three workgroups and two parts, the last one partly filled."""
    rng, gaussians = np.random.default_rng(1), scene(530, 9)
    masks = {name: BitMask.of(rng.random(530) < 0.3) for name in ("selected", "left_out") if name in changes}
    part = DrawItem(gaussians, np.eye(4), **masks, wetness=changes.get("wetness", 0.0))
    part = part._replace(wet_sh=scene(530, 9).sh) if part.wetness else part
    other = DrawItem(scene(40, 1), np.eye(4), growth=1.5, opacity=0.5)
    interpreted = InterpretedContext(5)
    keys, slots = filled(interpreted, [part, other], harmonics, look=look)
    assert list(interpreted.faults) == []
    expected_keys, expected_slots = filled(context, [part, other], harmonics, look=look)
    assert 100 < len(slots) < 530
    np.testing.assert_array_equal(slots, expected_slots)
    assert np.max(np.abs(keys.astype(np.int64) - expected_keys)) <= 8  # a few last bits of a float32


def test_a_frame_in_rain_runs_every_shader_without_a_race(context, one_digit):
    interpreted, results = InterpretedContext(7, warps=True), []
    for each in (interpreted, context):
        projection, store, sorter = ProjectionPass(each, GpuArrays(each)), ProjectedSplatBuffer(each), DepthSort(each)
        slots = projection.project(store, [DrawItem(scene(300, 1), np.eye(4))], CAMERA, drops_of(), "splats")
        projection.compact_visible(store, sorter, slots)
        visible = int(np.frombuffer(store.work.read(4, offset=COUNT_OFFSET), np.uint32)[0])
        gathered = np.frombuffer(sorter.unsorted[1].read(4 * visible), np.uint32)
        sorter.sort(store.work)
        results.append((visible, projection.drops.found().tolist(), gathered.tolist()))
    assert list(interpreted.faults) == []
    assert results[0] == results[1]
    assert len(results[0][1]) > 30
    files = {each.name: each for each in shipped_folder("shaders").iterdir() if each.name.endswith(".comp")}
    assert interpreted.shaders_run == set(files)
    assert all("// No races: " in each.read_text() for each in files.values())


def test_drops_under_roofs_are_left_out_without_a_race():
    field = drops_of()
    heights = np.where(np.add.outer(np.arange(30), np.arange(30)) % 7 < 4, 1.7, -np.inf).astype(np.float32)
    found = []
    for roofs in (None, ShelterMap(heights, (EYE[0] - 7.6, EYE[1] - 7.3))):
        interpreted = InterpretedContext(2)
        drops = RainPass(interpreted)
        drops.find(replace(field, roofs=roofs))
        assert list(interpreted.faults) == []
        found.append(set(drops.found().tolist()))
    assert set() < found[1] < found[0]


@pytest.mark.parametrize("number", [1, 2, 3])
def test_misses_each_barrier_of_emit(edit, number):
    """Streaks of several copies call it turn by turn."""
    parts = "\n".join(shaders.read_shader("common_projection.glsl")).split("barrier();")
    assert len(parts) == 4
    edit(
        "common_projection.glsl",
        "barrier();".join(parts),
        "barrier();".join(parts[:number]) + "barrier();".join(parts[number:]),
    )
    interpreted, field = InterpretedContext(number), drops_of()
    drops, store = RainPass(interpreted), ProjectedSplatBuffer(interpreted)
    store.reserve(streak_slots(field))
    drops.find(field)
    drops.project(store, field, 0)
    assert any("common_projection.glsl" in fault and "visible_mask" in fault for fault in interpreted.faults)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_misses_each_memory_barrier_of_the_sort(one_digit, number, monkeypatch):
    """Between counting, scanning, scattering, and what reads the order."""
    calls, barrier = [], InterpretedContext.memory_barrier
    monkeypatch.setattr(
        InterpretedContext,
        "memory_barrier",
        lambda self: calls.append(0) or (len(calls) - 1 != number and barrier(self)),
    )
    context = InterpretedContext(number)
    order_of(context, keys_of(300))
    assert len(calls) == 3
    assert context.faults


def test_a_frame_waits_for_those_who_read_the_last_one(context, monkeypatch):
    """Compute shaders write again what the last frame's vertices were read from: not before a memory barrier."""
    done = []

    def noted(owner, name, what):
        original = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *args, **kwargs: done.append(what) or original(*args, **kwargs))

    noted(moderngl.Context, "memory_barrier", "barrier")
    noted(moderngl.VertexArray, "render_indirect", "draw")
    for name in ("run", "run_indirect"):
        noted(moderngl.ComputeShader, name, "dispatch")
    renderer, rain = SplatRenderer(context), drops_of()
    for _ in range(3):
        renderer.draw([DrawItem(scene(300, 1), np.eye(4))], CAMERA, rain)
    draws = [at for at, what in enumerate(done) if what == "draw"]
    assert len(draws) == 3
    for at in draws:
        assert done[at - 1] == "barrier"
        following = done[at + 1 :]
        assert not following or following[0] == "barrier"
