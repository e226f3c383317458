"""Optics of a wet pane: refraction in a drop, blur by the lens, veil and blade, and the optics of a camera."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import filters_of
from gsrain_engine.render.frame_input import FrameInput, Mount
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_engine.scene.sensor import PINHOLE, ThinLens
from gsrain_engine.threads import limited_kernels
from gsrain_engine.water import refraction
from gsrain_engine.water.glass_drops import RADIUS, SHAPE
from gsrain_engine.water.pane import pane_of
from gsrain_engine.water.refraction import WATER_INDEX, GlassView, WetGlass, refracted, wide_camera
from gsrain_engine.water.wiper_glare import pivot_px
from small_scene import small_scene

SKY, ROAD = 230, 60


def camera_of(width=240, height=160):
    return Camera.from_fov(width, height, 40.0, look_at(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, 1.0])))


def glass_with(camera, *, kind="lens", drops=(), film=None, dirt=0.0, blade=None, distance=None, angle=50.0):
    pane = pane_of(kind, camera, distance)
    rows = np.zeros((len(drops), 10))
    for row, (u, v, radius) in zip(rows, drops, strict=True):
        row[:3], row[RADIUS], row[SHAPE] = (u, v, 1.0), radius, 0.5  # a round outline
    film = np.zeros((1, 1), np.float32) if film is None else film
    return WetGlass(pane, rows, film, 0.002, angle, blade, dirt, seed=0)


def horizon(camera):
    """View with a bright sky above a dark road."""
    image = np.full((camera.height, camera.width, 3), ROAD, np.uint8)
    image[: round(camera.cy)] = SKY
    return image


def through(glass, camera, lens=PINHOLE):
    return GlassView(glass, camera, lens, horizon(wide_camera(camera))).picture(horizon(camera))


# One drop


@pytest.mark.parametrize("angle", [20.0, 50.0, 80.0])
def test_a_ray_through_the_middle_goes_straight_on(angle):
    share, *direction = refracted((0.0, 0.0), (0.0, 0.0, 1.0), angle)
    reflected = ((WATER_INDEX - 1) / (WATER_INDEX + 1)) ** 2
    assert direction == pytest.approx([0, 0, 1], abs=1e-12) and share == pytest.approx(1 - reflected)


def test_near_its_axis_a_drop_is_a_lens_with_the_focal_length_of_its_curvature():
    radius_of_curvature = 1 / np.sin(np.radians(50.0))
    for x in (0.01, -0.02, 0.03):
        _, dx, _, dz = refracted((x, 0.0), (0.0, 0.0, 1.0), 50.0)
        assert dx / dz == pytest.approx(-x * (WATER_INDEX - 1) / radius_of_curvature, rel=2e-3)


@pytest.mark.parametrize("place", [(0.5, 0.2), (-0.3, 0.6)])
@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_refraction_follows_snells_law_at_the_surface(place, slope):
    ray = np.array([np.sin(slope), 0.0, np.cos(slope)])
    _, *after = refracted(place, tuple(ray), 40.0)
    inside = np.array([ray[0] / WATER_INDEX, 0.0, 0.0])
    inside[2] = np.sqrt(1 - inside[0] ** 2)
    sphere = 1 / np.sin(np.radians(40.0))
    center = np.array([0, 0, -sphere * np.cos(np.radians(40.0))])
    start = np.array([*place, 0.0]) - center
    path = -start @ inside + np.sqrt((start @ inside) ** 2 - start @ start + sphere**2)
    normal = (start + path * inside) / sphere
    assert np.linalg.norm(after) == pytest.approx(1.0)
    assert np.cross(after, normal) == pytest.approx(WATER_INDEX * np.cross(inside, normal), abs=1e-9)


def test_light_at_the_rim_of_a_steep_drop_is_reflected_back():
    assert refracted((0.97, 0.0), (0.0, 0.0, 1.0), 60.0)[0] == 0.0
    assert refracted((0.97, 0.0), (0.0, 0.0, 1.0), 30.0)[0] > 0.8


def test_a_slanted_ray_next_to_a_steep_drop_meets_its_outside():
    ray = np.array([1.0, 0.0, 0.4]) / np.hypot(1, 0.4)
    assert refracted((-1.05, 0.0), tuple(ray), 70.0)[0] >= 0.0
    assert refracted((-3.0, 0.0), tuple(ray), 70.0)[0] == -1.0
    assert refracted((-1.05, 0.0), (0.0, 0.0, 1.0), 70.0)[0] == -1.0


# A pane in a picture


def test_a_sharp_drop_shows_the_view_upside_down_inside_of_its_outline():
    camera = camera_of()
    picture = through(glass_with(camera, drops=[(0.0, 0.0, 0.002)]), camera)
    clear = horizon(camera)
    radius_px = camera.fx * 0.002 / 0.02
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    distance = np.hypot(x - camera.cx, y - camera.cy)
    assert np.array_equal(picture[distance > radius_px + 1], clear[distance > radius_px + 1])
    column, middle = picture[:, camera.width // 2, 0].astype(int), camera.height // 2
    third = round(radius_px / 3)
    assert abs(column[middle - third] - ROAD) < 12 and abs(column[middle + third] - SKY) < 12
    steep = through(glass_with(camera, drops=[(0.0, 0.0, 0.002)], angle=70.0), camera)
    rim = (distance > 0.9 * radius_px) & (distance < 0.96 * radius_px)
    assert steep[rim].max() < 20 < picture[rim].min()  # total reflection


def test_an_open_lens_spreads_a_drop_over_its_circle_of_confusion_and_keeps_its_coverage():
    camera = camera_of()
    glass = glass_with(camera, drops=[(0.0, 0.0, 0.0004)], distance=0.1, angle=30.0)
    sharp, cell, _ = GlassView(glass, camera, PINHOLE, horizon(wide_camera(camera))).layer(horizon(camera))
    lens = ThinLens(0.01, 10.0)
    blurred, wide_cell, margin = GlassView(glass, camera, lens, horizon(wide_camera(camera))).layer(horizon(camera))
    assert cell == 1 and wide_cell > 1
    area_px = np.pi * (camera.fx * 0.0004 / 0.1) ** 2
    assert sharp[..., 3].sum() == pytest.approx(area_px, rel=0.1)
    assert blurred[..., 3].sum() * wide_cell**2 == pytest.approx(area_px, rel=0.15)
    rows = np.flatnonzero(blurred[..., 3].max(axis=1) > 0)
    circle_px = camera.fx * 0.01 * (1 / 0.1 - 1 / 10)
    assert abs(len(rows) * wide_cell - circle_px) <= 3 * wide_cell and margin * wide_cell > circle_px / 2


@pytest.mark.parametrize("lens", [PINHOLE, ThinLens(0.002, 10.0)])
def test_drops_as_small_as_a_cell_cover_no_more_than_it(lens, monkeypatch):
    monkeypatch.setattr(refraction, "_blurred", lambda layer, radii: layer)
    camera = camera_of()

    def layer_of(drops):
        view = GlassView(glass_with(camera, drops=drops), camera, lens, horizon(wide_camera(camera)))
        return view.layer(horizon(camera))

    cell_px = layer_of([])[1]
    cell_m = cell_px * 0.02 / camera.fx
    middles = cell_m * (np.arange(-8, 9, 2) + 0.5)
    places = [(u, v) for u in middles for v in middles]
    layer = layer_of([(u, v, size * cell_m) for u, v in places for size in (0.7, 0.9, 0.8)])[0]
    assert (cell_px == 1) == (lens is PINHOLE) and layer[..., 3].max() > 0.9
    assert layer.min() >= 0 and layer.max() <= 1 + 1e-6
    for size in (0.3, 0.6, 0.9):  # a single one covers its area, wherever it lies in its cell
        single = layer_of([(0.3 * cell_m, 0.4 * cell_m, size * cell_m)])[0]
        assert single[..., 3].sum() == pytest.approx(np.pi * size**2, rel=0.05)


def test_a_dry_clean_pane_changes_nothing_and_dirt_spreads_light():
    camera = camera_of()
    clear = horizon(camera)
    assert np.array_equal(through(glass_with(camera, kind="windshield"), camera), clear)
    dirty = through(glass_with(camera, kind="windshield", dirt=0.8), camera).astype(int)
    assert (dirty[clear == ROAD] > ROAD).all() and (dirty[clear == SKY] < SKY).all()


def test_the_film_blurs_and_the_blade_hides():
    camera = camera_of()
    film = np.full((400, 400), 5e-6, np.float32)
    wet = through(glass_with(camera, kind="windshield", film=film), camera).astype(int)
    edge = camera.height // 2
    assert wet[edge, 120, 0] > ROAD + 10 and wet[edge - 1, 120, 0] < SKY - 10
    blade = through(glass_with(camera, kind="windshield", blade=np.radians(76.0)), camera)
    assert (blade.max(axis=2) < 40).any() and (blade == horizon(camera)).all(axis=2).mean() > 0.4


def test_film_of_a_wiper_draws_lamps_into_streaks_towards_its_pivot():
    camera = camera_of()
    night = np.full((camera.height, camera.width, 3), 8, np.uint8)
    night[40:46, 150:156] = 255, 60, 40  # a red lamp
    wide = np.full((80, 120, 3), 8, np.uint8)
    film = np.full((400, 400), 5e-6, np.float32)
    pane = pane_of("windshield", camera)
    glass = glass_with(camera, kind="windshield", film=film, blade=np.radians(2.0))
    wet = GlassView(glass, camera, PINHOLE, wide).picture(night).astype(int)
    x, y, z = pivot_px(pane, camera)
    along = np.array([153.0 - x / z, 43.0 - y / z])
    along /= np.hypot(*along)
    at, off = (np.rint([43, 153] + 20 * np.array(each)).astype(int) for each in (along[::-1], (-along[0], along[1])))
    red = [int(wet[*place, 0]) for place in (at, 2 * np.array([43, 153]) - at, off)]
    assert min(red[:2]) > red[2] + 20 and wet[*at, 0] > wet[*at, 1] + 20
    dry = GlassView(replace(glass, film_m=0 * film), camera, PINHOLE, wide).picture(night).astype(int)
    assert wet[*off, 0] < dry[*at, 0] < wet[*at, 0]
    unwiped = GlassView(replace(glass, blade_rad=None, film_m=0 * film), camera, PINHOLE, wide).picture(night)
    assert np.array_equal(unwiped, night)


# A camera


RAIN = RainSettings(intensity_mm_h=20.0, glass="windshield", glass_wet_s=2.0, wiper="off")


def sequence_in(rain, camera=None):
    path = CameraPath(
        np.array([0.0, 4.0]), np.array([[-6.0, 0, 1.5], [-4.0, 0, 1.5]]), np.tile([0.5, -0.5, 0.5, -0.5], (2, 1)),
        np.array([45.0, 45.0]),
    )  # fmt: skip
    return FrameSequence(small_scene(), RainSimulation.start(rain), camera or path, 120, 80, fps=5.0)


def images_of(rain, numbers, **kinds):
    renderer, sequence = CpuRenderer(), sequence_in(rain)
    sky = sequence.sky(renderer)
    return [sequence.image(renderer, number, sky, **kinds) for number in numbers]


def test_same_seed_same_bytes_and_any_frame_alone_on_any_number_of_threads():
    together = images_of(RAIN, [0, 3, 1])
    for threads in (1, 3):
        with limited_kernels(threads):
            assert together[2].tobytes() == images_of(RAIN, [1])[0].tobytes()
    assert together[1].tobytes() == images_of(RAIN, [3])[0].tobytes()
    other = images_of(msgspec.structs.replace(RAIN, seed=1, streaks=False), [1])[0]
    assert other.tobytes() != images_of(msgspec.structs.replace(RAIN, streaks=False), [1])[0].tobytes()


def test_floats_in_8_bits_have_the_same_glass():
    renderer, sequence = CpuRenderer(), sequence_in(RAIN)
    sky = sequence.sky(renderer)
    assert np.array_equal(sequence.frame(renderer, 2, sky).to_uint8(), sequence.image(renderer, 2, sky))


def test_without_glass_rain_and_clear_pictures_are_as_before():
    renderer = CpuRenderer()
    plain, glazed = (sequence_in(msgspec.structs.replace(RAIN, glass=kind)) for kind in ("none", "windshield"))
    sky = plain.sky(renderer)
    view = plain.shot(0)
    assert filters_of(renderer, plain.frame_input(view, OVERCAST)) == ()
    assert not np.array_equal(plain.image(renderer, 0, sky), glazed.image(renderer, 0, sky))
    clean = sequence_in(msgspec.structs.replace(RAIN, glass_dirt=0.0))
    assert np.array_equal(plain.image(renderer, 0, None), clean.image(renderer, 0, None))


def test_figures_of_a_frame_are_those_of_the_flux():
    state = sequence_in(RAIN).glass_state(0)
    assert state.seconds == pytest.approx(2.0) and state.area_m2 > 0
    assert abs(state.impacts - state.expected_impacts) < 4 * np.sqrt(state.expected_impacts)
    none = sequence_in(msgspec.structs.replace(RAIN, glass="none")).glass_state(0)
    assert (none.impacts, none.expected_impacts, none.seconds, none.area_m2) == (0, 0, 0, 0)


def test_a_camera_that_looks_back_has_a_lens_and_no_windshield():
    renderer, scene, view = CpuRenderer(), small_scene(), RenderView(camera_of(96, 64))
    back = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    for kind, has_glass in (("windshield", False), ("lens", True)):
        rainfall = RainSimulation.start(msgspec.structs.replace(RAIN, glass=kind))
        frame = FrameInput.of(scene, rainfall, OVERCAST, view, mount=Mount(camera_to_vehicle=back))
        assert bool(filters_of(renderer, frame)) == has_glass


def test_the_paper_has_no_glass_and_values_have_bounds():
    assert load_preset("paper").glass == "none"
    with pytest.raises(ValueError, match="glass_distance_m must be within 0.005..2 m, got 3.0"):
        RainSettings(glass_distance_m=3.0)


def test_linear_light_is_what_coverage_shares():
    camera = camera_of()
    dirty = through(glass_with(camera, kind="windshield", dirt=1.0), camera)[..., 0]
    share = (srgb_to_linear(dirty / 255) - srgb_to_linear(np.array(ROAD / 255)))[horizon(camera)[..., 0] == ROAD]
    mean = srgb_to_linear(np.array([SKY, ROAD]) / 255).mean() - srgb_to_linear(np.array(ROAD / 255))
    assert 0.02 < share.mean() / mean < 0.2


@pytest.mark.parametrize("cell_px", [1, 4])
def test_pictures_through_glass_are_those_of_the_transfer_function(cell_px, monkeypatch):
    random = np.random.default_rng(1)
    image = random.integers(0, 256, (40, 52, 3)).astype(np.uint8)
    layer = np.zeros((40 // cell_px + 2, 52 // cell_px + 2, 4), np.float32)
    layer[..., 3] = np.linspace(0, 1, layer.shape[1])
    layer[..., :3] = layer[..., 3:] * np.array([0.0, 0.3, 0.9])
    monkeypatch.setattr(GlassView, "layer", lambda view, image: (layer, cell_px, 1))
    camera = camera_of(52, 40)
    made = GlassView(glass_with(camera), camera, PINHOLE, image).picture(image)
    x = ((np.arange(52) + 0.5) / cell_px + 0.5) * layer[0, 1, 3]
    light = srgb_to_linear(image / 255) * (1 - x[:, None]) + x[:, None] * np.array([0.0, 0.3, 0.9])
    assert np.abs(made - 255 * linear_to_srgb(light)).max() < 0.7
