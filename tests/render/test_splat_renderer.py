from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.render.opengl import shaders
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.render.opengl.shaders import ShaderError, load_compute_shader, load_program
from gsrain_engine.render.opengl.sort import RadixSort
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import DrawItem
from render.cpu.raster_scenes import drawn

CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)


@pytest.fixture
def renderer(context):
    return SplatRenderer(context)


def cloud(count, coefficients=1):
    """Gaussians by chance, half transparent."""
    rng, f = np.random.default_rng(3), np.float32
    means, turns = rng.uniform([-2, -1, 1], [2, 1, 9], (count, 3)), np.tile(np.array([1, 0, 0, 0], f), (count, 1))
    sh = rng.normal(0, 0.3, (count, coefficients, 3)).astype(f)
    return Gaussians(means.astype(f), np.full((count, 3), 0.1, f), turns, np.full(count, 0.5, f), sh)


def draw(renderer, set_, **options):
    return drawn(renderer, set_, camera=CAMERA, **options)


def test_splats_lie_in_several_blocks_as_far_as_the_driver_allows(context, monkeypatch):
    whole = draw(SplatRenderer(context), cloud(3000)).rgba
    for slots, count in ((1024, 3000), (256, 1024)):
        monkeypatch.setitem(context.info, "GL_MAX_SHADER_STORAGE_BLOCK_SIZE", 32 * slots)
        renderer = SplatRenderer(context)
        assert count < 3000 or draw(renderer, cloud(3000)).rgba.tobytes() == whole.tobytes()
        draw(renderer, cloud(count))
    with pytest.raises(MemoryError, match="1280 Gaussians"):
        draw(renderer, cloud(1025))


def test_sorting_on_the_gpu_draws_the_same(context, monkeypatch):
    """Also where the processor would sort, since OpenGL is software."""
    by_host = draw(SplatRenderer(context), cloud(9000)).rgba
    monkeypatch.setattr("gsrain_engine.render.opengl.renderer.CpuSort", RadixSort)
    by_gpu = SplatRenderer(context)
    assert draw(by_gpu, cloud(9000)).rgba.tobytes() == by_host.tobytes()
    assert by_gpu.statistics.splats_drawn > 3000


@pytest.fixture
def tiles(context):
    return SplatRenderer(context, rasterizer="tiles")


def test_tiles_in_strips_are_the_same_bytes_and_a_row_without_room_is_an_error(context, tiles, monkeypatch):
    some, most = larger(cloud(1000), 4), larger(cloud(1000), 40)
    whole = draw(tiles, some, with_depth=True)
    monkeypatch.setitem(context.info, "GL_MAX_SHADER_STORAGE_BLOCK_SIZE", 4 * 2900)
    strips = SplatRenderer(context, rasterizer="tiles")
    for _ in range(2):
        found = draw(strips, some, with_depth=True)
        assert (found.rgba.tobytes(), found.depth.tobytes()) == (whole.rgba.tobytes(), whole.depth.tobytes())
    with pytest.raises(MemoryError, match="a row of 4 tiles"):
        draw(strips, most)
    assert draw(strips, some).rgba.tobytes() == whole.rgba.tobytes()


def larger(set_, factor):
    return replace(set_, scales=np.float32(factor) * set_.scales)


def test_pairs_that_find_no_room_are_counted_and_drawn_when_the_image_is_read(context, tiles, monkeypatch):
    monkeypatch.setattr("gsrain_engine.render.opengl.tiles._FIRST_PAIRS", 1)
    few, many = cloud(50), larger(cloud(400), 20)
    expected = draw(SplatRenderer(context, rasterizer="tiles"), many).rgba
    draw(tiles, few)
    tiles.draw([DrawItem(many, np.eye(4))], CAMERA)
    tiles.finish()
    assert tiles.statistics.pairs_left_out > 1000
    assert tiles.read().rgba.tobytes() == expected.tobytes()
    assert tiles.statistics.pairs_left_out == 0
    tiles.draw([DrawItem(many, np.eye(4))], CAMERA)
    tiles.finish()
    assert tiles.statistics.pairs_left_out == 0


def test_many_tiles_need_a_third_digit(context, tiles):
    """16,640 of them, numbered by 15 bits."""
    camera = Camera(2080, 2048, 1700.0, 1700.0, 1040.0, 1024.0)
    found, expected = (drawn(each, cloud(200), camera=camera).rgba for each in (tiles, SplatRenderer(context)))
    assert np.abs(found - expected).max() < 5e-3 < expected.max()  # a fragment at the cut


@pytest.mark.parametrize(("width", "height"), [(64, 48), (61, 7)])
def test_bytes_made_on_the_gpu_are_those_of_the_floats(context, renderer, width, height):
    camera = CAMERA.resized(width, height)
    for background in ((0.0, 0.0, 0.0), (0.25, 0.5, 1.0)):
        renderer.draw([DrawItem(cloud(500), np.eye(4))], camera)
        image, expected = renderer.read_uint8(background), renderer.read().to_uint8(background)
        assert np.abs(image.astype(int) - expected).max() <= (1 if any(background) else 0)
        assert expected.std() > 10


def test_requested_bytes_are_those_of_their_image_while_others_are_drawn_and_requested(context, renderer):
    images, requests = [], []
    for count in (20, 100, 400, 800, 1600):  # more than the ring has buffers
        renderer.draw([DrawItem(cloud(count), np.eye(4))], CAMERA.resized(64 + count % 7, 48))
        requests.append(renderer.request_uint8())
        images.append(renderer.read().to_uint8())
    order = [3, 0, 4, 2, 1]
    assert len({each.tobytes() for each in images}) == 5
    for number in order + order:  # any number of times
        np.testing.assert_array_equal(requests[number](), images[number])


@pytest.mark.parametrize("between", ["nothing", "a drawing", "a reading"])
def test_a_requested_image_whose_pairs_had_no_room_is_drawn_again(context, tiles, monkeypatch, between):
    monkeypatch.setattr("gsrain_engine.render.opengl.tiles._FIRST_PAIRS", 1)
    few, many = ([DrawItem(each, np.eye(4))] for each in (cloud(50), larger(cloud(400), 20)))
    whole = SplatRenderer(context, rasterizer="tiles")
    whole.draw(many, CAMERA)
    expected = whole.read_uint8()
    tiles.draw(few, CAMERA)
    tiles.read()
    tiles.draw(many, CAMERA)
    requests = [tiles.request_uint8(), tiles.request_uint8()]
    if between == "a drawing":
        tiles.draw(few, CAMERA)
    elif between == "a reading":
        tiles.read()
    for request in requests:
        np.testing.assert_array_equal(request(), expected)


def test_harmonics_in_fewer_bits_show_nearly_the_same_and_change_their_storage_in_place(context):
    renderer = SplatRenderer(context)
    for coefficients in (1, 4, 9, 16):
        set_ = cloud(500, coefficients)
        exact = draw(SplatRenderer(context, harmonics="single"), set_).rgba
        for harmonics, tolerance in (("half", 2e-3), ("byte", 2e-2)):
            renderer.arrays.keep_harmonics_as(harmonics)
            small = draw(renderer, set_).rgba
            assert 0 < np.abs(small - exact).max() < tolerance
        renderer.arrays.keep_harmonics_as("single")
        assert draw(renderer, set_).rgba.tobytes() == exact.tobytes()


def test_uploading_in_slices_draws_the_same_and_cancelling_it_changes_nothing(renderer, context):
    set_, other = cloud(5000), cloud(300)
    steps = list(renderer.arrays.upload(set_, slice_size=1000))
    assert len(steps) == 20
    assert steps[-1] == 1.0
    assert draw(renderer, set_).rgba.tobytes() == draw(SplatRenderer(context), set_).rgba.tobytes()
    slices = renderer.arrays.upload(other, slice_size=100)
    for _ in range(7):  # two arrays, and a third of the third
        next(slices)
    slices.close()
    renderer.arrays.release_awaited()
    assert (renderer.arrays.missing(set_), renderer.arrays.missing(other)) == (0, 300)
    assert len(list(renderer.arrays.upload(other, slice_size=100))) == 12


def test_error_names_our_file_and_line(context, monkeypatch):
    files = {
        "broken.comp": ["#version 430", '#include "common_bad.glsl"', "layout(local_size_x = 1) in;", "void main() {}"],
        "common_bad.glsl": ["// fine", "float f() { return undeclared; }"],
    }
    monkeypatch.setattr(shaders, "read_shader", files.__getitem__)
    with pytest.raises(ShaderError, match=r"common_bad.glsl:2"):
        load_compute_shader(context, "broken.comp")


def test_switches_reach_the_shader(context):
    plain = load_program(context, "screen.vert", "heat.frag")
    depth = load_program(context, "screen.vert", "heat.frag", switches={"DEPTH": 1})
    assert plain.glo != depth.glo
