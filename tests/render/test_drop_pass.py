"""Drops on the GPU: the same places to the bit, the same drops, the same picture as from the compiled kernels."""

import msgspec
import numpy as np
import pytest

from given_rain import gaussians_of, given_rain
from gsrain_engine.presets import shipped_path
from gsrain_engine.rain.drop_field import CLASS_STRIDE, place_drops
from gsrain_engine.rain.frame import RainCamera
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.rain.properties import CLASSES
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.rain.shelter_map import ShelterMap
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.opengl.rain import RainPass, class_rows, moved_words
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.scene.camera import Camera, look_at

EYE = np.array([3.0, -2.0, 1.5])
CAMERA = Camera.from_fov(320, 200, 45.0, look_at(EYE, EYE + np.array([1, 0.2, 0.1]), np.array([0, 0, 1.0])))
ANCHOR = np.eye(4)
ANCHOR[:3, 3] = EYE


SHOWER = RainKeyframes(
    keys=(
        RainKeyframe(time_s=-3.0, intensity_mm_h=0.5, wind_m_s=(8.0, -3.0)),
        RainKeyframe(time_s=20.0, intensity_mm_h=12.0),
        RainKeyframe(time_s=12_000.0, intensity_mm_h=2.0, wind_m_s=(-5.0, 1.0)),
    ),
    between="smooth",
)


def falling(time_s=12.3, travelled=(0.0, 0.0, 0.0), weather=None, anchor=ANCHOR, focal_px=None, roofs=None, **changes):
    changes = {"wind_m_s": (2.0, -1.0), "seed": 3, "haze": "gaussians"} | changes
    rain = msgspec.structs.replace(load_preset("8.5"), **changes)
    anchor = anchor.copy()
    anchor[:3, 3] += travelled
    view = RainCamera(CAMERA, anchor, np.array([9.0, 1.0, 0.0]), focal_px, roofs)
    return RainSimulation.start(rain, weather=weather).frame(time_s, view)


@pytest.mark.parametrize(
    ("time_s", "travelled", "changes"),
    [
        (12.3, (0.0, 0.0, 0.0), {}),
        (10_000.0, (8_000.0, -6_000.0, 120.0), {"gust_m_s": 5.0}),
        (9_876.543, (-10_000.0, 0.3, -80.0), {"intensity_mm_h": 50.0}),
        (77.7, (300.0, -40.0, 2.0), {"wind_m_s": (15.0, -9.0), "gust_m_s": 6.0, "turbulence_m_s": 3.0}),
        (10_000.0, (6_000.0, 8_000.0, 0.0), {"model": "paper"}),
        (12.3, (0.0, 0.0, 0.0), {"weather": SHOWER}),
        (9_876.543, (-6_000.0, 8_000.0, 0.0), {"weather": SHOWER, "gust_m_s": 5.0}),
    ],
)
def test_every_drop_is_at_the_same_place_to_the_bit(context, time_s, travelled, changes):
    """From the first seconds to 10,000 s, and 10 km down the road."""
    field = falling(time_s, travelled=travelled, **changes)
    body = (shipped_path("shaders") / "common_drop_field.glsl").read_text()
    shader = context.compute_shader(f"""#version 430
        layout(local_size_x = 256) in;
        {body}
        layout(std430, binding = 2) writeonly buffer Out {{ uint placed[]; }};
        void main() {{
            uint i = gl_GlobalInvocationID.x;
            uvec3 p = place(i, i * {CLASS_STRIDE}u % CLASSES).at;
            placed[3u * i] = p.x; placed[3u * i + 1u] = p.y; placed[3u * i + 2u] = p.z;
        }}""")
    count = 40 * CLASSES
    rows, placed = context.buffer(class_rows(field)), context.buffer(reserve=12 * count)
    moved = context.buffer(moved_words(field))
    moved.bind_to_storage_buffer(0)
    rows.bind_to_storage_buffer(1)
    placed.bind_to_storage_buffer(2)
    shader["seed"] = field.rain.seed
    shader.run(count // 256)
    ours = np.frombuffer(placed.read(), np.uint32).reshape(-1, 3)
    np.testing.assert_array_equal(ours, place_drops(np.arange(count), field.rain.seed, field.where).fractions)


@pytest.mark.parametrize(
    "changes",
    [
        {}, {"exposure_s": 0.05}, {"model": "paper"},
        {"max_copies": 1}, {"wind_m_s": (15.0, -9.0), "turbulence_m_s": 3.0},
        {"streak_gain": 20.0}, {"aperture_mm": 8.0}, {"weather": SHOWER},
    ],
)  # fmt: skip
def test_draws_what_the_compiled_kernels_make(context, changes):
    renderer = SplatRenderer(context)
    rain = falling(**changes)
    renderer.draw([], CAMERA, rain)
    made_there, statistics = renderer.read().rgba, renderer.statistics
    given = given_rain(gaussians_of(rain), rain.light_linear, rain.rain.model)
    renderer.draw([], CAMERA, given)
    made_here = renderer.read().rgba
    assert np.linalg.norm(made_here) > 1
    assert np.linalg.norm(made_there - made_here) < 2e-3 * np.linalg.norm(made_here)
    assert statistics.drops_drawn == pytest.approx(len(rain.visible_drops().numbers), rel=2e-3)
    assert statistics.haze_drawn == len(rain.haze) > 0


@pytest.mark.parametrize("rasterizer", ["quads", "tiles"])
def test_falling_rain_creates_no_buffers(context, monkeypatch, rasterizer):
    """Haze and drops are written over those of the frame before, and look as in a renderer of their own."""
    renderer, created, create = SplatRenderer(context, rasterizer=rasterizer), [], type(context).buffer
    monkeypatch.setattr(type(context), "buffer", lambda *args, **sizes: created.append(1) or create(*args, **sizes))
    frames = [falling(time_s) for time_s in (12.3, 12.4, 12.5)]
    assert len({each.haze.means.tobytes() for each in frames}) == 3
    for number, rain in enumerate(frames):
        renderer.draw([], CAMERA, rain)
        made = renderer.read().rgba
        assert bool(created) is (number == 0)
        created.clear()
    alone = SplatRenderer(context, rasterizer=rasterizer)
    alone.draw([], CAMERA, frames[-1])
    assert made.tobytes() == alone.read().rgba.tobytes()


def test_rain_comes_and_goes_in_one_renderer(context):
    """Fewer drops than in the frame before leave none of its streaks behind."""
    renderer = SplatRenderer(context)
    for rain in (falling(), falling(intensity_mm_h=0.3), None, falling(streaks=False)):
        renderer.draw([], CAMERA, rain)
        again = SplatRenderer(context)
        again.draw([], CAMERA, rain)
        assert renderer.read().rgba.tobytes() == again.read().rgba.tobytes()


@pytest.mark.parametrize(
    "changes",
    [{}, {"intensity_mm_h": 0.05}, {"model": "paper"}, {"weather": SHOWER}],
)
def test_finds_the_drops_that_the_compiled_search_finds(context, changes):
    """Also those that roofs leave."""
    heights = np.where(np.add.outer(np.arange(30), np.arange(30)) % 7 < 4, 1.7, -np.inf).astype(np.float32)
    roofs = ShelterMap(heights, (EYE[0] - 7.6, EYE[1] - 7.3))
    turned, drops, counts = ANCHOR.copy(), RainPass(context), []
    turned[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
    for each in (None, roofs, None):
        field = falling(anchor=turned, focal_px=1500.0, roofs=each, **changes)
        drops.find(field)
        expected, found = set(field.visible_drops().numbers.tolist()), drops.found().tolist()
        assert len(found) == len(set(found)) == drops.found_count() <= field.max_drops
        assert len(expected ^ set(found)) <= 0.002 * len(expected) + 1  # float32 decides at the edges
        counts.append(len(expected))
    assert 0.2 * counts[0] < counts[1] < 0.9 * counts[0] == 0.9 * counts[2]
