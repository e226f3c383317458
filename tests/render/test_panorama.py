"""Panoramas, stereo images and transparent backgrounds: geometry, seams, and the files that hold them."""

from dataclasses import replace

import av
import msgspec
import numpy as np
import pytest
from PIL import Image

from gsrain_engine.editor.recorder import _fitting
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.export import film_frames, render_video
from gsrain_engine.render.export_settings import EXPORT_PRESETS, ExportSettings
from gsrain_engine.render.panorama import EYES_APART_M, compose, views_of
from gsrain_engine.render.renderer import Frame
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import Layer, Scene
from small_scene import small_scene

UP, EYE = np.array([0.0, 0, 1]), np.array([2.0, -1.0, 1.5])
W, H = 256, 128


def camera_along(direction, width=W, height=H):
    return Camera.from_fov(width, height, 60.0, look_at(EYE, EYE + np.array(direction, float), UP))


def balls(directions, distance=5.0):
    """Small bright Gaussians around the eye."""
    count = len(directions)
    means = EYE + distance * np.array(directions, float) / np.linalg.norm(directions, axis=1, keepdims=True)
    f = np.float32
    gaussians = Gaussians(
        means.astype(f), np.full((count, 3), 0.08, f), np.tile([1, 0, 0, 0], (count, 1)).astype(f), np.ones(count, f),
        sh_from_color(np.ones((count, 3), f)),
    )  # fmt: skip
    return Scene("balls", (Layer("balls", gaussians),))


def film(scene, camera, mm_h=0.0, **settings):
    recording = ExportSettings(output="frame.npy", size_px=(camera.width, camera.height), **settings)
    return next(film_frames(CpuRenderer(), recording, scene, RainSettings(intensity_mm_h=mm_h), camera))


def test_faces_fade_into_each_other_and_know_their_directions():
    shot = RenderView(camera_along([0.5, -1, 0.3]), 0.0)
    views = views_of(shot, "360")
    sides = [np.tile(np.append(each.camera.world_to_camera[2, :3], 1.0), (8, 8, 1)) for each in views]
    white = compose([Frame(np.ones_like(each, np.float32)) for each in sides], "360", W, H)
    np.testing.assert_allclose(white.rgba, 1, atol=1e-6)  # the weights of all faces add up to 1
    forward = compose([Frame(each.astype(np.float32)) for each in sides], "360", W, H).rgba[..., :3]
    heading = np.array([0.5, -1, 0]) / np.hypot(0.5, 1)
    assert forward[H // 2, W // 2] == pytest.approx(heading, abs=1e-6)  # ahead, and level
    assert forward[H // 2, 3 * W // 4] == pytest.approx([heading[1], -heading[0], 0], abs=1e-6)  # right
    assert forward[0, 7] == pytest.approx(UP, abs=1e-6) and forward[-1, 99] == pytest.approx(-UP, abs=1e-6)
    assert np.abs(np.diff(forward, axis=1, append=forward[:, :1])).max() < 0.75  # a fade, no step of 1


def test_what_is_around_is_at_its_place_also_across_edges_and_corners_of_the_cube():
    camera = camera_along([1, 0, 0])
    # Ahead, at an edge between two faces, at a corner of three, nearly above, behind.
    angles_deg = [(0, 0), (45, 0), (45, 35.26), (10, 80), (180, -20), (-100, -46)]  # to the right, up
    directions = [(np.cos(b) * np.cos(a), -np.cos(b) * np.sin(a), np.sin(b)) for a, b in np.radians(angles_deg)]
    frame = film(balls(directions), camera, projection="360")
    rows, columns = np.mgrid[:H, :W] + 0.5
    weight = frame.rgba[..., 3]
    for right, up in angles_deg:
        x, y = (right / 360 + 0.5) % 1 * W, (0.5 - up / 180) * H
        away = np.abs((columns - x + W / 2) % W - W / 2) * np.cos(np.radians(up))
        near = np.hypot(away, rows - y) < 4
        shift = ((columns - x + W / 2) % W - W / 2)[near] @ weight[near] / weight[near].sum()
        assert weight[near].max() > 0.4 and abs(shift) * np.cos(np.radians(up)) < 0.35, (right, up)
        assert abs((rows[near] - y) @ weight[near] / weight[near].sum()) < 0.35


def test_the_eyes_of_a_stereo_image_are_apart():
    camera = camera_along([1, 0, 0], 240, 80)
    rgba = film(balls([(1, 0, 0)], distance=2.0), camera, projection="stereo").rgba
    columns = np.arange(120) + 0.5
    left, right = (columns @ half[..., 3].sum(axis=0) / half[..., 3].sum() for half in (rgba[:, :120], rgba[:, 120:]))
    assert left - right == pytest.approx(camera.fx * EYES_APART_M / 2.0, abs=0.05)
    assert left + right == pytest.approx(120, abs=0.05)


def test_a_transparent_background_is_that_of_the_file(tmp_path):
    scene, rain = small_scene(), RainSettings(intensity_mm_h=12.0)
    camera = Camera.from_fov(96, 64, 60.0, look_at(np.array([0.0, 0, 2]), np.array([1.0, 0, 2]), UP))

    def write(name, **settings):
        recording = ExportSettings(output=str(tmp_path / name), transparent=True, fps=10.0, **settings)
        list(render_video(CpuRenderer(), recording, scene, rain, camera))
        return tmp_path / name

    pixels = np.asarray(Image.open(write("a.png"))).astype(int)
    assert pixels.shape == (64, 96, 4) and pixels[0, :, 3].max() < 30 and pixels[-1, :, 3].min() > 230
    opaque = next(film_frames(CpuRenderer(), ExportSettings(output="a.png"), scene, rain, camera)).to_uint8()
    np.testing.assert_allclose(pixels[-1, :, :3], opaque[-1].astype(int), atol=6)  # the road as it is
    with av.open(str(write("a.webm", last_s=0.2, size_px=(96, 64)))) as container:
        stream = container.streams.video[0]
        decoder = av.CodecContext.create("libvpx-vp9", "r")  # FFmpeg's own drops the alpha
        frames = [each for packet in container.demux(stream) for each in decoder.decode(packet)]
    alpha = frames[0].to_ndarray(format="rgba")[..., 3]
    assert len(frames) == 2 and alpha[0].max() < 60 and alpha[-1].min() > 200


def test_what_a_cut_out_lacks_is_the_light_of_the_medium_behind_it():
    scene, camera = balls([(1, 0, 0)], distance=4.0), camera_along([1, 0, 0], 96, 64)
    rain = RainSettings(intensity_mm_h=25.0, drop_color=(0.2, 0.4, 0.6))
    whole, cut_out = (
        next(film_frames(CpuRenderer(), ExportSettings(output="a.exr", transparent=each), scene, rain, camera)).rgba
        for each in (False, True)
    )
    behind = whole[..., 3:] - cut_out[..., 3:]
    assert behind.min() > -1e-6 and behind.max() > 0.02 and cut_out[..., 3].max() > 0.8
    np.testing.assert_allclose(whole[..., :3], cut_out[..., :3] + behind * rain.drop_color, atol=2e-3)


def test_a_cut_out_has_no_dark_fringe_before_the_ground():
    scene, camera = replace(balls([(1, 0, 0)], distance=1.0), ground_m=0.0), camera_along([1, 0, -0.3], 96, 64)
    rgba = film(scene, camera, 12.0, transparent=True).to_rgba8()
    fringe = rgba[(rgba[..., 3] > 25) & (rgba[..., 3] < 230)]
    assert len(fringe) > 20 and fringe[:, :3].min() > 150  # a white ball


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"output": "a.mp4", "transparent": True}, "h264 holds no transparency"),
        ({"output": "a.png", "projection": "360", "size_px": (640, 480)}, "twice as wide as high"),
        ({"output": "a.png", "projection": "stereo", "size_px": (641, 480)}, "even width"),
        ({"output": "a", "projection": "360", "size_px": (64, 32), "passes": ("labels",)}, "labels needs"),
    ],
)
def test_what_a_projection_can_not_do_is_named(fields, sentence):
    with pytest.raises(ValueError, match=sentence):
        ExportSettings(**fields).check()


def test_presets_are_possible_and_settings_fit_each_other():
    for preset in EXPORT_PRESETS:
        recording = ExportSettings(**({"output": "clip"} | dict(preset.fields)))
        msgspec.structs.replace(recording, output=f"clip{recording.default_suffix}").check()
    values = {"projection": "360", "size_px": (1920, 1080), "transparent": True, "codec": "h264"}
    assert _fitting({"projection": "360"}, values)["size_px"] == (1920, 960)
    assert _fitting({"size_px": (0, 0)}, values)["size_px"] == (2160, 1080)
    assert _fitting({"transparent": True}, values)["codec"] == "vp9"
    assert _fitting({"codec": "h264"}, values)["transparent"] is False
