"""Orthographic cameras: parallel rays, a scale, nothing before the picture plane; plans and marks by the command."""

import json
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from gsrain_engine.backends import open_renderer
from gsrain_engine.editor.viewport.camera import find_scene_core
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FALLING, FILTERS
from gsrain_engine.render.plan_marks import mark_lines, round_length, scale_bar
from gsrain_engine.render.provenance import PictureProvenance, frame_of
from gsrain_engine.render.sequence import FollowingCamera, FrameSequence
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.orthographic import orientation, orthographic, scaled_camera
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack
from small_scene import patch, small_scene

SIZE = 160, 96


def plan(scene, pixels_per_m=4.0, direction="top", size=SIZE):
    core = find_scene_core(scene)
    return scaled_camera(core, orientation(scene, direction), core.middle, size, pixels_per_m)


def driving():
    """The small scene with a red car on its road, which drives 4 m in a second along +x."""
    track = PoseTrack(
        np.array([0.0, 2.0]), np.array([[8.0, 0, 0], [16, 0, 0]]), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool)
    )
    roof = patch((-2, -1, 1.5), np.array([4.0, 0, 0]), np.array([0, 2.0, 0]), 16, (0.9, 0.1, 0.1))
    return replace(small_scene(), actors=(Actor("car", "car", (4.0, 2.0, 1.6), roof, track),))


def pixels_of(points_m, camera):
    return camera.pixels(
        np.asarray(points_m, np.float64) @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    )


def test_equal_lengths_are_equally_long_at_every_depth():
    camera = plan(small_scene())
    for height in (0.0, 4.0, 9.0):
        (left, top), (right, bottom) = pixels_of([[10, 3, height], [20, -2, height]], camera)
        assert (right - left, bottom - top) == pytest.approx((10 * 4.0, 5 * 4.0), abs=0.02)
        assert pixels_of([[10, 3, height]], camera)[0] == pytest.approx(pixels_of([[10, 3, 0]], camera)[0], abs=0.05)
    assert camera.pixels_per_m == pytest.approx(4.0)
    slanted = plan(small_scene(), direction="ortho")
    steps = np.diff(pixels_of([[0, 0, 0], [10, 0, 0], [20, 0, 0], [30, 0, 0]], slanted), axis=0)
    np.testing.assert_allclose(steps, steps[:1].repeat(3, axis=0), atol=0.02)


def test_a_camera_becomes_orthographic_with_the_same_picture_at_a_depth():
    pinhole = Camera.from_fov(
        *SIZE, 50.0, look_at(np.array([-10.0, 0, 6]), np.array([20.0, 0, 1]), np.array([0, 0, 1.0]))
    )
    camera = orthographic(pinhole, 25.0, find_scene_core(small_scene()))
    at_depth = pinhole.position + 25.0 * pinhole.world_to_camera[2, :3]
    places = at_depth + np.array([[0, 0, 0], [0, 5.0, 0], [0, -3.0, 0]])
    np.testing.assert_allclose(pixels_of(places, camera), pixels_of(places, pinhole), atol=0.05)
    again = Camera.from_json(json.loads(json.dumps(camera.to_json())))
    assert again.is_orthographic and again.plane_m == camera.plane_m and not pinhole.is_orthographic
    with pytest.raises(ValueError, match="plane_m"):
        Camera.from_json(camera.to_json() | {"plane_m": -1.0})


@pytest.mark.parametrize("backend", ["cpu", "opengl-quads", "opengl-tiles"])
def test_the_whole_core_is_drawn_and_nothing_before_it(backend):
    scene = small_scene()
    roof = patch((-100, -100, 300), np.array([300.0, 0, 0]), np.array([0, 200.0, 0]), 20, (0.0, 0.0, 1.0))
    below = [each for each in scene.layers if each.kind != "sky"]
    covered = replace(scene, layers=(*below, Layer("sky", roof, kind="sky")))
    camera = plan(scene)
    with open_renderer(backend) as renderer:
        open_air, covered_air = (
            FrameSequence(each, RainSimulation.start(RainSettings()), camera, *SIZE).image(renderer, 0, None)
            for each in (replace(scene, layers=tuple(below)), covered)
        )
    np.testing.assert_array_equal(covered_air, open_air)
    middle = open_air[SIZE[1] // 2, 20:-30].astype(int)
    assert (middle.max(axis=1) > 60).all() and (np.ptp(middle, axis=1) < 40).all()  # gray road


def test_back_ends_agree():
    camera, found = plan(driving(), direction="ortho"), []
    for backend in ("cpu", "opengl-quads", "opengl-tiles"):
        with open_renderer(backend) as renderer:
            sequence = FrameSequence(driving(), RainSimulation.start(RainSettings()), camera, *SIZE)
            found.append(sequence.image(renderer, 0, None).astype(float))
    for each in found[1:]:
        assert 10 * np.log10(255**2 / np.mean((each - found[0]) ** 2)) > 45


def test_rain_gives_its_light_and_nothing_that_falls():
    rainfall = RainSimulation.start(RainSettings(intensity_mm_h=25.0, glass="windshield"))
    scene, camera = small_scene(), plan(small_scene())
    sequence = FrameSequence(scene, rainfall, camera, *SIZE)
    frame = sequence.frame_input(sequence.shot(0), sequence.sky(CpuRenderer()))
    assert frame.falling is None and frame.without >= FALLING | FILTERS
    overcast = sequence.frame(CpuRenderer(), 0, sequence.sky(CpuRenderer()), with_depth=True)
    assert overcast.depth is not None
    road = overcast.depth[SIZE[1] // 2, SIZE[0] // 2]
    core = find_scene_core(scene)
    assert road == pytest.approx(core.high[2] + 0.5 * core.radius_m, abs=0.2)  # of the road at 0 m, from the plane


def test_a_following_camera_keeps_a_road_user_in_the_middle():
    scene = driving()
    first = scaled_camera(find_scene_core(scene), orientation(scene, "top"), np.array([8.0, 0, 0]), SIZE, 8.0)
    camera = FollowingCamera(scene, scene.actors[0].track, first)
    for time_s, x in ((-1.0, 8.0), (0.0, 8.0), (0.5, 10.0), (2.0, 16.0), (9.0, 16.0)):
        assert pixels_of([[x, 0, 0]], camera.at(time_s))[0] == pytest.approx((80, 48), abs=0.01)
    sequence = FrameSequence(scene, RainSimulation.start(RainSettings()), camera, *SIZE, fps=2)
    pictures = [sequence.image(CpuRenderer(), number, None) for number in range(3)]
    assert sequence.length_s == 2.0
    for each in pictures:
        red = (each[..., 0].astype(int) - each[..., 1] > 80).nonzero()
        assert np.mean(red, axis=1) == pytest.approx((48, 80), abs=1.5)


def test_marks_are_where_they_belong():
    scene, camera = driving(), plan(driving(), 8.0)
    lines = mark_lines(scene, RenderView(camera, 1.0), ("grid", "boxes", "paths"))
    by_mark = {name: [each.points_px for each in lines if each.mark == name] for name in ("grid", "boxes", "paths")}
    box = np.concatenate(by_mark["boxes"])
    expected = pixels_of([[10, 1, 0], [14, -1, 0]], camera)
    np.testing.assert_allclose([box.min(axis=0), box.max(axis=0)], expected, atol=0.1)
    car, ego = by_mark["paths"]
    np.testing.assert_allclose(car[[0, -1]], pixels_of([[8, 0, 0], [16, 0, 0]], camera), atol=0.1)
    np.testing.assert_allclose(ego[[0, -1]], pixels_of([[0, 0, 1.5], [10, 0, 1.5]], camera), atol=0.1)
    upright = sorted({round(float(each[0, 0]), 2) for each in by_mark["grid"] if abs(np.ptp(each[:, 0])) < 1e-3})
    np.testing.assert_allclose(np.diff(upright), 80.0, atol=0.05)  # each 10 m
    assert scale_bar(replace(camera, fx=100 * camera.fx, fy=100 * camera.fy)).label == "2 cm"
    assert scale_bar(camera).label == "2 m" and scale_bar(camera).length_px == pytest.approx(16.0)
    assert [round_length(each) for each in (0.7, 1.0, 1.2, 3.0, 600.0)] == [1.0, 1.0, 2.0, 5.0, 1000.0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("plans") / "driving"
    write_scene(driving(), path)
    return path


def rendered(folder, tmp_path: Path, *words):
    output = tmp_path / f"{abs(hash(words))}.png"
    assert run(["render", str(folder), "-o", str(output), "--backend", "cpu", *words]) == 0
    return np.asarray(Image.open(output))


def test_the_command_draws_plans_to_scale(folder, tmp_path, capsys):
    picture = rendered(folder, tmp_path, "--camera", "top", "--pixels-per-meter", "6", "--rain", "12")
    core = find_scene_core(driving())
    height, width = picture.shape[:2]
    assert (width, height) == pytest.approx(tuple(1.2 * 6 * (core.high - core.low)[:2]), abs=2)
    assert "6 px/m" in capsys.readouterr().out
    followed = rendered(folder, tmp_path, "--camera", "top:car", "--size", "120x80", "--time", "1")
    red = (followed[..., 0].astype(int) - followed[..., 1] > 80).nonzero()
    assert np.mean(red, axis=1) == pytest.approx((40, 60), abs=1.5)
    placed = rendered(folder, tmp_path, "--camera", "top:12,0", "--size", "120x80", "--time", "1")
    np.testing.assert_array_equal(placed, followed)
    marked = rendered(folder, tmp_path, "--camera", "ortho", "--size", "120x80", "--marks", "grid,scale,boxes,paths")
    plain = rendered(folder, tmp_path, "--camera", "ortho", "--size", "120x80")
    assert 0.01 < np.mean((marked != plain).any(axis=-1)) < 0.6


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--camera", "top:bus"], "has no road user 'bus'; there is car, ego"),
        (["--camera", "top:1,x"], "expected X,Y in meters"),
        (["--camera", "top", "--glass", "windshield"], "--glass: an orthographic picture has"),
        (["--camera", "top", "--pixels-per-meter", "2000"], "at most 16,384"),
        (["--pixels-per-meter", "5"], "only --camera top and ortho have a scale"),
        (["--marks", "grid"], "only an orthographic picture has a scale"),
        (["--camera", "top", "--camera-path", "a.json"], "exclude each other"),
    ],
)
def test_what_has_no_effect_is_refused(folder, tmp_path, capsys, words, said):
    assert run(["render", str(folder), "-o", str(tmp_path / "a.png"), *words]) == BAD_INPUT
    assert said in capsys.readouterr().err and not (tmp_path / "a.png").exists()


def test_a_drawn_plan_can_be_drawn_again_from_its_provenance(folder, tmp_path):
    output = tmp_path / "plan.png"
    assert run(["render", str(folder), "-o", str(output), "--camera", "top", "--size", "64x48", "--rain", "5"]) == 0
    facts = json.loads((tmp_path / "plan.provenance.json").read_text())
    (values,) = facts["pictures"].values()
    again = draw(CpuRenderer(), frame_of(msgspec.convert(values, PictureProvenance), read_scene(folder)))
    np.testing.assert_array_equal(again.read_uint8(), np.asarray(Image.open(output)))
