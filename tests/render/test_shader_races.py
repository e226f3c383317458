"""Compute shaders on a GPU made of Python: threads in shuffled orders, and every access that nothing puts in order."""

import itertools
from dataclasses import replace

import moderngl
import msgspec
import numpy as np
import pytest

from gsrain_engine.presets import shipped_path
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
from gsrain_engine.render.opengl.shaders import GpuTimers
from gsrain_engine.render.opengl.sort import CpuSort, RadixSort, sort_faults
from gsrain_engine.render.opengl.tiles import TileRasterizer
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import DrawItem
from interpreted_gpu.context import AwaitedFaultError, InterpretedContext

EYE = np.array([3.0, -2.0, 1.5])
CAMERA = Camera.from_fov(64, 48, 45.0, look_at(EYE, EYE + np.array([1, 0.2, 0.1]), np.array([0, 0, 1.0])))
ANCHOR = np.eye(4)
ANCHOR[:3, 3] = EYE


@pytest.fixture
def without_barrier(monkeypatch):
    """Take one of a shader's barriers out for this test; `count` is how many there are."""
    read, texts = shaders.read_shader, {}

    def change(name, number, count):
        parts = "\n".join(read(name)).split("barrier();")
        assert len(parts) == count + 1
        texts[name] = ("barrier();".join(parts[:number]) + "barrier();".join(parts[number:])).split("\n")

    monkeypatch.setattr(shaders, "read_shader", lambda name: texts.get(name) or read(name))
    return change


SEEN_ELSEWHERE = {"radix_count_subgroups.comp", "radix_scatter_subgroups.comp", "picture_bytes.comp"}
DIGIT_BITS, ROUNDS = 4, 2
KEYS_BY_GROUP = 256 * ROUNDS


@pytest.fixture(autouse=True)
def small_sort(monkeypatch):
    """Sort fewer keys by shorter digits, since interpreted threads take their time."""
    read, bits = shaders.read_shader, sort.DIGIT_BITS
    changes = {
        f"ROUNDS = {sort.KEYS_BY_GROUP // 256}u": f"ROUNDS = {ROUNDS}u",
        f"DIGIT_BITS = {bits}u": f"DIGIT_BITS = {DIGIT_BITS}u",
    }
    assert all("\n".join(read("common_radix.glsl")).count(old) == 1 for old in changes)

    def changed(name):
        text = "\n".join(read(name))
        for old, new in changes.items():
            text = text.replace(old, new)
        return text.split("\n")

    monkeypatch.setattr(shaders, "read_shader", changed)
    monkeypatch.setattr(sort, "DIGIT_BITS", DIGIT_BITS)
    monkeypatch.setattr(sort, "KEYS_BY_GROUP", KEYS_BY_GROUP)


@pytest.fixture
def one_digit(monkeypatch):
    """Sort by the lowest digit of keys alone."""
    monkeypatch.setattr(sort, "KEY_BITS", DIGIT_BITS)


@pytest.fixture(params=[False, True], ids=["plain", "subgroups"])
def subgroups(request, monkeypatch):
    """Sort without subgroups, or with those that the interpreted GPU has."""
    use_subgroups(monkeypatch, request.param)


def use_subgroups(monkeypatch, uses):
    found = (lambda context: isinstance(context, InterpretedContext)) if uses else (lambda context: False)
    monkeypatch.setattr(sort, "has_subgroups_of_32", found)
    if uses:  # the threads of a subgroup count four digits each
        read, short = shaders.read_shader, f"DIGIT_BITS = {DIGIT_BITS}u"
        monkeypatch.setattr(
            shaders, "read_shader", lambda name: [line.replace(short, "DIGIT_BITS = 7u") for line in read(name)]
        )
        monkeypatch.setattr(sort, "DIGIT_BITS", 7)
        monkeypatch.setattr(InterpretedContext, "run", run_but_scan)


def run_but_scan(self, program, uniforms, groups, run=InterpretedContext.run):
    """Add up the counts of 128 digits at once: with 16 digits, without subgroups, the scan's own threads do."""
    if program.name != "radix_scan.comp":
        run(self, program, uniforms, groups)
        return
    counts, totals, work = (self.bindings[each].memory.words for each in (sort.COUNTS, 5, sort.WORK))
    used = 128 * -(-work[COUNT_OFFSET // 4] // KEYS_BY_GROUP)
    counts[:used] = [0, *itertools.accumulate(counts[: used - 1])]
    next_turn = 128 * (1 - uniforms["u_turn"])
    totals[next_turn : next_turn + 128] = [0] * 128


def keys_of(count, digits=1):
    return np.random.default_rng(count).integers(0, 1 << digits * DIGIT_BITS, count, dtype=np.uint32)


def order_of(context, keys):
    sorter = RadixSort(context)
    sorter.reserve(len(keys))
    for buffer, values in zip(sorter.unsorted, (keys, np.arange(len(keys), dtype=np.uint32)), strict=True):
        buffer.write(values)
    work = np.array([0, 0, 0, 0, 0, len(keys)], np.uint32)
    return np.frombuffer(sorter.sort(context.buffer(work.tobytes())).read(4 * len(keys)), np.uint32)


@pytest.mark.parametrize("warps", [False, True])
@pytest.mark.parametrize(("count", "digits"), [(KEYS_BY_GROUP + 300, 1), (300, 2)])
def test_the_sort_has_no_race_in_any_order_of_threads(monkeypatch, subgroups, count, digits, warps):
    monkeypatch.setattr(sort, "KEY_BITS", digits * DIGIT_BITS)
    context, keys = InterpretedContext(count, warps=warps), keys_of(count, digits)
    np.testing.assert_array_equal(order_of(context, keys), np.argsort(keys, kind="stable"))
    assert list(context.faults) == []


@pytest.mark.parametrize("warps", [False, True])
def test_finds_the_round_that_began_before_the_last_one_was_over(without_barrier, one_digit, warps):
    """The shader as it was: on an H100 it lost a hundredth to a half of all splats. On llvmpipe it sorts well."""
    without_barrier("radix_scatter.comp", 4, 4)
    context, keys = InterpretedContext(1, warps=warps), keys_of(700)
    order = order_of(context, keys)
    assert any("radix_scatter.comp:" in fault and "mask" in fault for fault in context.faults)
    check = sort_faults(keys, order, order_of(InterpretedContext(2, warps=warps), keys))
    assert min(check.missing, check.inversions, check.changed) > 0


BARRIERS = {
    "radix_count.comp": 2,
    "radix_scan.comp": 7,
    "radix_scatter.comp": 4,
    "radix_count_subgroups.comp": 1,
    "radix_scatter_subgroups.comp": 4,
    "common_projection.glsl": 3,
    "tile_count.comp": 2,
    "tile_emit.comp": 3,
    "tile_blend.comp": 3,
}


@pytest.mark.parametrize(
    ("name", "number"), [(name, number) for name, count in BARRIERS.items() for number in range(1, count + 1)]
)
def test_misses_each_barrier(monkeypatch, without_barrier, one_digit, name, number):
    """Not one of them could go, and none that goes is overlooked. Streaks of several copies run one turn by turn."""
    use_subgroups(monkeypatch, "subgroups" in name)
    without_barrier(name, number, BARRIERS[name])
    context = InterpretedContext(number, awaited=name)
    with pytest.raises(AwaitedFaultError):
        if name.startswith("tile"):
            tiles_of(context, [DrawItem(scene(100, 1), np.eye(4))])
        elif name.endswith(".comp"):
            order_of(context, keys_of(700))
        else:
            field, drops, store = drops_of(), RainPass(context), ProjectedSplatBuffer(context)
            store.reserve(streak_slots(field))
            drops.find(field)
            drops.project(store, field, 0)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_misses_each_memory_barrier_of_the_sort(one_digit, number, monkeypatch):
    """Between counting, scanning, scattering, and what reads the order."""
    calls, barrier = [], InterpretedContext.memory_barrier

    def but_one(self):
        calls.append(self)
        if len(calls) - 1 != number:
            barrier(self)

    monkeypatch.setattr(InterpretedContext, "memory_barrier", but_one)
    context = InterpretedContext(number)
    order_of(context, keys_of(300))
    assert len(calls) == 3
    assert context.faults


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
    rain = msgspec.structs.replace(load_preset("8.5"), seed=3, max_copies=2, haze="none", **changes)
    field = RainSimulation.start(rain).frame(12.3, RainCamera(CAMERA, ANCHOR, np.zeros(3)))
    culling = field.culling._replace(class_far_m=np.full(CLASSES, 30.0), slopes=np.array([-2.0, 2.0, -2.0, 2.0]))
    where = field.where
    return replace(field, count=400, find_drops=lambda: (where, culling))


def filled(context, parts, harmonics="half", rain=None, look="splats"):
    """Project, bring together and sort as a frame does; returns keys and slots of what can be seen, and the drops."""
    project, store = ProjectionPass(context, GpuArrays(context, harmonics)), ProjectedSplatBuffer(context)
    sorter = RadixSort(context)
    slots = project.project(store, parts, CAMERA, rain, look)
    project.compact_visible(store, sorter, slots)
    visible = int(np.frombuffer(store.work.read(4, offset=COUNT_OFFSET), np.uint32)[0])
    keys, order = (np.frombuffer(each.read(4 * visible), np.uint32) for each in sorter.unsorted)
    if rain is None:
        return keys, order, []
    sorter.sort(store.work)
    return keys, order, project.drops.found().tolist()


def tiles_of(context, parts, rain=None, look="splats", max_pairs=8192):
    """Draw a frame by tiles; returns the picture, and depths. By default the pairs of all tiles fit."""
    project, store = ProjectionPass(context, GpuArrays(context)), ProjectedSplatBuffer(context)
    sorter, rasterizer = CpuSort(context), TileRasterizer(context, max_pairs)
    slots = project.project(store, parts, CAMERA, rain, look)
    project.compact_visible(store, sorter, slots)
    size, linear = (CAMERA.width, CAMERA.height), rain is not None
    images = context.texture(size, 4, dtype="f4"), context.texture(size, 2, dtype="f4")
    rasterizer.draw(
        store, sorter.sort(store.work), slots.all, (*images, None),
        {"WITH_DEPTH": 1, **({"LINEAR_RAIN": 1} if linear else {})},
        {"rain_light": (0.4, 0.5, 0.6)} if linear else {}, GpuTimers(context),
    )  # fmt: skip
    return [np.frombuffer(each.read(), np.float32).reshape(CAMERA.height, CAMERA.width, -1) for each in images]


@pytest.mark.parametrize(("rainy", "has_subgroups", "max_pairs"), [(False, True, 8192), (True, False, 125)])
def test_draws_tiles_without_a_race_as_a_driver_draws_them(context, monkeypatch, rainy, has_subgroups, max_pairs):
    """At once, and in strips."""
    use_subgroups(monkeypatch, has_subgroups)
    parts, rain = [DrawItem(scene(150, 1), np.eye(4))], drops_of() if rainy else None
    interpreted = InterpretedContext(11, warps=rainy)
    pictures = [tiles_of(each, parts, rain, max_pairs=max_pairs) for each in (interpreted, context)]
    assert list(interpreted.faults) == []
    for ours, driver, most in zip(*pictures, (1.0, 50.0), strict=True):
        assert driver.max() > 0.1
        np.testing.assert_allclose(ours, driver, atol=2e-3 * most)


@pytest.mark.parametrize(
    ("harmonics", "fields", "look"),
    [
        ("half", {}, "splats"),
        ("single", {"wetness": 0.5, "wet_sh": -scene(530, 9).sh}, "splats"),
        ("byte", {name: BitMask.of(np.arange(530) % 7 < 2) for name in ("selected", "left_out")}, "splats"),
        ("half", {}, "normals"),
    ],
)
def test_projects_without_a_race_what_a_driver_projects(context, harmonics, fields, look):
    """Across three workgroups and two parts, the last one partly filled."""
    parts = [DrawItem(scene(530, 9), np.eye(4), **fields), DrawItem(scene(40, 1), np.eye(4), growth=1.5, opacity=0.5)]
    interpreted = InterpretedContext(5)
    keys, slots, _ = filled(interpreted, parts, harmonics, look=look)
    assert list(interpreted.faults) == []
    expected_keys, expected_slots, _ = filled(context, parts, harmonics, look=look)
    assert 100 < len(slots) < 530
    np.testing.assert_array_equal(slots, expected_slots)
    assert np.max(np.abs(keys.astype(np.int64) - expected_keys)) <= 8  # a few last bits of a float32


@pytest.mark.parametrize("has_roofs", [False, True])
def test_a_frame_in_rain_runs_every_shader_without_a_race(context, one_digit, has_roofs):
    heights = np.where(np.add.outer(np.arange(30), np.arange(30)) % 7 < 4, 1.7, -np.inf).astype(np.float32)
    roofs = ShelterMap(heights, (EYE[0] - 7.6, EYE[1] - 7.3)) if has_roofs else None
    rain, parts = replace(drops_of(), roofs=roofs), [DrawItem(scene(300, 1), np.eye(4))]
    interpreted = InterpretedContext(7, warps=True)
    (_, slots, drops), (_, *expected) = (filled(each, parts, rain=rain) for each in (interpreted, context))
    assert list(interpreted.faults) == []
    assert [slots.tolist(), drops] == [expected[0].tolist(), expected[1]]
    assert (len(drops) < 120) == has_roofs
    assert len(drops) > 30
    if not has_roofs:
        tiles_of(interpreted, [DrawItem(scene(30, 1), np.eye(4))])
        files = {each.name: each for each in shipped_path("shaders").iterdir() if each.name.endswith(".comp")}
        assert interpreted.shaders_run == set(files) - SEEN_ELSEWHERE
        assert all("// No races: " in each.read_text() for each in files.values())


def test_a_frame_waits_for_those_who_read_the_last_one(context, monkeypatch):
    """Compute shaders write again what the last frame's vertices were read from: not before a memory barrier."""
    done = []

    def noted(owner, name, what):
        original = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *args, **kwargs: done.append(what) or original(*args, **kwargs))

    noted(moderngl.Context, "memory_barrier", "barrier")
    noted(moderngl.VertexArray, "render_indirect", "draw")
    noted(moderngl.ComputeShader, "run", "dispatch")
    renderer, rain = SplatRenderer(context), drops_of()
    for _ in range(3):
        renderer.draw([DrawItem(scene(300, 1), np.eye(4))], CAMERA, rain)
    draws = [at for at, what in enumerate(done) if what == "draw"]
    assert len(draws) == 3
    for at in draws:
        assert done[at - 1] == "barrier"
        following = done[at + 1 :]
        assert not following or following[0] == "barrier"
