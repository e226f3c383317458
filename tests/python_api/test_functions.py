"""The functions of `gsrain`: what they return, that they agree with the command line, and how they refuse bad input."""

import threading
from dataclasses import replace
from io import BytesIO
from operator import methodcaller

import av
import numpy as np
import pytest
from PIL import Image

import gsrain as gr
from app.main import run
from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.geometry import linear_to_srgb
from small_scene import small_scene

SIZE = (96, 64)


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def rain():
    return gr.Rain(intensity=8.5, wind=(2, 0), seed=1)


def test_load_takes_the_axis_and_the_unit(tmp_path, scene):
    gr.save(scene, tmp_path / "bare.ply")
    assert gr.load(tmp_path / "bare.ply").up == (0, -1, 0)
    lying = gr.load(str(tmp_path / "bare.ply"), up="z", scale=0.5)
    assert lying.up == (0, 0, 1) and lying.metres_per_unit == 0.5 and not lying.unit_is_assumed
    unsorted = gr.load(tmp_path / "bare.ply", sort=False)
    assert np.array_equal(unsorted.layers[0].gaussians.means[:400, 0], scene.layers[0].gaussians.means[:, 0])
    with pytest.raises(gr.SceneFormatError, match=r"nothing\.ply"):
        gr.load(tmp_path / "nothing.ply")


def test_rain_has_short_names_and_all_fields(rain):
    assert rain == gr.RainSettings(intensity_mm_h=8.5, wind_m_s=(2, 0), seed=1)
    assert isinstance(rain, gr.Rain) and isinstance(rain, gr.RainSettings) and not isinstance(8.5, gr.Rain)
    assert gr.Rain(5, haze="none", wetness=1.0) == gr.RainSettings(intensity_mm_h=5, haze="none", wetness=1.0)
    assert gr.Rain.preset("paper").exposure_s == 0.05


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda scene: gr.load("street", up="k"), "up 'k'"),
        (lambda scene: gr.load("street", scale=0), "scale 0"),
        (lambda scene: gr.Rain(intensity=150), "at most 149 - at `intensity`"),
        (lambda scene: gr.Rain(wind=(99, 0)), "99 must be at most 40 - at `wind"),
        (lambda scene: gr.Rain(exposure=7.0), "7 must be at most 1 - at `exposure`"),
        (lambda scene: gr.Rain(intensty=8), "unknown field `intensty`; did you mean `intensity"),
        (lambda scene: gr.Rain(intensity=float("nan")), "nan"),
        (lambda scene: gr.measure_rain(gr.Rain(8.5), seconds=0), "seconds 0"),
        (lambda scene: gr.render(scene, 8.5), r"rain 8\.5: expected rain settings, such as gr\.Rain"),
        (lambda scene: gr.render(scene, camera="a.json"), r"camera 'a\.json': expected a gr\.Camera"),
        (lambda scene: gr.render(scene, size=(0, 64)), r"at least 1 - at `size\[0\]`"),
        (lambda scene: gr.render_video(scene, None, None, "odd.mp4", size=(97, 64)), "even width"),
        (lambda scene: gr.frames(scene, start=2.0, end=1.0), "end must be above start"),
        (lambda scene: gr.CameraPath.orbit(scene, seconds=0), "above 0 s"),
        (lambda scene: gr.wet(scene, method="fog"), "'fog'"),
        (lambda scene: gr.wet(scene, method="images"), "images="),
        (lambda scene: gr.wet(scene, weights="none.pkl"), r"weights none\.pkl"),
        (lambda scene: gr.wet(scene, sed=3), "did you mean `seed`"),
        (lambda scene: gr.wet(scene, views=0), ">= 1"),
        (lambda scene: gr.drive(scene, agent="nobody"), "agent nobody"),
        (lambda scene: gr.drive(replace(scene, ego=None)), "drive"),
    ],
)
def test_bad_input_is_named(scene, call, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=words):
        call(scene)
    assert not list(tmp_path.iterdir())


def test_rain_from_a_disdrometer(tmp_path):
    logs = [tmp_path / f"{intensity}.nc" for intensity in (2.0, 8.0)]
    for log in logs:
        rainfall = RainSimulation.start(gr.Rain(float(log.stem)))
        write_spectra(log, VirtualDisdrometer(rainfall, 0.1).measure(np.arange(0.0, 181.0, 60.0)).spectra)
    rain = gr.Rain.from_disdrometer(logs, save_to=tmp_path / "here" / "cal.yaml")
    assert rain.intensity_mm_h == pytest.approx(5.0, rel=0.05)
    assert rain.calibration == str(tmp_path / "here" / "cal.yaml")
    assert gr.measure_rain(rain, seconds=20).rate == pytest.approx(rain.intensity_mm_h, rel=0.1)
    assert gr.Rain.from_disdrometer(logs, intensity=3, save_to=tmp_path / "cal.yaml").intensity_mm_h == 3


def test_rain_is_measured():
    measured = gr.measure_rain(gr.Rain(8.5), seconds=60)
    assert isinstance(measured.rate, float) and abs(measured.rate - 8.5) < 4 * measured.standard_error
    assert str(measured) == f"{measured.rate:.2f} +- {measured.standard_error:.2f} mm/h"
    assert measured.drops > 1000 and 0.3 < measured.mean_diameter < 2


def test_an_image_is_what_the_command_renders(tmp_path, scene, rain):
    gr.save(scene, tmp_path / "scene")
    image = gr.render(gr.load(tmp_path / "scene"), gr.Rain(8.5), size=SIZE, time=2.0, backend="cpu")
    camera = tmp_path / "camera.json"
    camera.write_text(str(gr.home_camera(scene, SIZE).to_json()).replace("'", '"'))
    for suffix in (".png", ".jpg", ".npy"):
        command, own = tmp_path / f"command{suffix}", tmp_path / "own" / f"image{suffix}"
        assert not run(["render", str(tmp_path / "scene"), "--camera", str(camera), "--rain", "8.5", "--time", "2",
                        "--backend", "cpu", "-o", str(command)])  # fmt: skip
        image.save(own)
        assert own.read_bytes() == command.read_bytes()


def test_an_image_in_every_form(tmp_path, scene, rain):
    image = gr.render(scene, rain, size=SIZE, time=2.0, backend="cpu")
    assert image.rgb.shape == (64, 96, 3) and image.rgb.dtype == np.uint8 and (image.width, image.height) == SIZE
    assert image.linear.dtype == np.float32
    assert np.abs(linear_to_srgb(image.linear) * 255 - image.rgb).max() <= 0.51
    assert image.alpha.max() == pytest.approx(1, abs=0.01) and 30 < image.depth.max() < 130
    assert np.array_equal(np.asarray(image), image.rgb) and np.asarray(image, np.float32).dtype == np.float32
    with Image.open(BytesIO(methodcaller("_repr_png_")(image))) as shown:
        assert np.array_equal(np.asarray(shown), image.rgb)
    assert repr(image) == "<gsrain.Image 96 x 64, with depth>"
    flat = gr.render(scene, rain, size=SIZE, depth=False, backend="cpu")
    with pytest.raises(ValueError, match="depth=True"):
        flat.depth  # noqa: B018
    with pytest.raises(ValueError, match=r"clip\.mp4: expected the name of an image"):
        image.save(tmp_path / "clip.mp4")


def test_a_camera_can_be_given_or_a_path(scene):
    camera, path = gr.home_camera(scene, SIZE), gr.CameraPath.orbit(scene, seconds=6)
    own = gr.render(scene, camera=camera, backend="cpu")
    assert np.array_equal(own.rgb, gr.render(scene, size=SIZE, backend="cpu").rgb)
    assert gr.render(scene, camera=camera, size=(48, 32), backend="cpu").rgb.shape == (32, 48, 3)
    middle = gr.render(scene, camera=path, size=SIZE, time=3.0, backend="cpu")
    assert np.abs(middle.rgb.astype(float) - own.rgb).mean() < 1  # an orbit passes its home camera


def test_a_named_view_is_what_the_command_renders(tmp_path, scene):
    tilted = replace(scene, metres_per_unit=2.0, up=(0.1, 0.0, 1.0))
    home = gr.home_camera(tilted, SIZE)
    named = gr.save_view(tilted, "Gate", home.shifted(right=1.0), time=2.0, rain=gr.Rain(30.0))
    named = gr.save_view(named, "Bare", home)
    gr.save(named, tmp_path / "scene")
    loaded = gr.load(tmp_path / "scene")
    assert [view.name for view in loaded.views] == ["Gate", "Bare"] and tilted.views == ()
    camera, time, rain = gr.view(loaded, "Gate", SIZE)
    np.testing.assert_allclose(camera.world_to_camera, home.shifted(right=1.0).world_to_camera, atol=1e-9)
    assert (time, rain) == (2.0, gr.Rain(30.0)) and gr.view(loaded, "Bare")[1:] == (0.0, None)
    gr.render(loaded, rain, camera, time=time, backend="cpu").save(tmp_path / "own.png")
    assert not run(["render", str(tmp_path / "scene"), "--view", "Gate", "--size", "96x64", "--backend", "cpu",
                    "-o", str(tmp_path / "command.png")])  # fmt: skip
    assert (tmp_path / "own.png").read_bytes() == (tmp_path / "command.png").read_bytes()
    with pytest.raises(ValueError, match="did you mean 'Gate'"):
        gr.view(loaded, "gat")
    with pytest.raises(ValueError, match="printable"):
        gr.save_view(scene, " ", home)


def test_paths_of_a_scene(tmp_path, scene):
    tilted = replace(scene, up=(0.0, -1.0, 0.0), metres_per_unit=2.0)
    path = gr.CameraPath.orbit(tilted, seconds=6, degrees=90)
    assert (path.start_s, path.end_s) == (0.0, 6.0) and isinstance(path, gr.CameraPath)
    path.save(tmp_path / "path.json", tilted)
    assert gr.CameraPath.read(tmp_path / "path.json", tilted).positions == pytest.approx(path.positions)
    assert gr.CameraPath.default(scene).end_s == 5.0  # the ego vehicle's drive


def test_frames_are_those_of_the_video(tmp_path, scene, rain):
    path = gr.CameraPath.orbit(scene, seconds=1)
    steps = []
    folder = gr.render_video(scene, rain, path, tmp_path / "frames", size=SIZE, fps=4, clear_pair="sunny",
                             progress=steps.append, backend="cpu")  # fmt: skip
    frames = list(gr.frames(scene, rain, path, size=SIZE, fps=4, depth=True, backend="cpu"))
    written = [np.asarray(Image.open(each)) for each in sorted(folder.glob("*.png"))]
    assert len(written) == len(frames) == 4 and steps[-1].fraction == 1
    assert all(np.array_equal(each, frame.rgb) for each, frame in zip(written, frames, strict=True))
    assert frames[0].depth.shape == (64, 96)
    assert len(list((tmp_path / "frames.clear").glob("*.png"))) == 4
    video = gr.render_video(scene, None, None, tmp_path / "dry.mp4", size=SIZE, fps=2, end=1.0, backend="cpu")
    with av.open(str(video)) as file:
        assert len(list(file.decode(video=0))) == 2


def test_a_renderer_is_used_by_threads_and_then_closed(scene, rain):
    found = []
    with gr.Renderer("cpu") as renderer:
        work = (
            lambda: found.append(renderer.render(scene, rain, size=SIZE).rgb),
            lambda: found.append(next(renderer.frames(scene, rain, size=SIZE)).rgb),
        )
        threads = [threading.Thread(target=each) for each in work]
        for each in threads:
            each.start()
        for each in threads:
            each.join()
        frames = renderer.frames(scene, rain, size=SIZE)
        assert repr(renderer) == "<gsrain.Renderer cpu>"
    assert len(found) == 2 and found[0].shape == found[1].shape == (64, 96, 3)
    for use in (lambda: renderer.render(scene), lambda: next(frames)):
        with pytest.raises(ValueError, match="closed"):
            use()


def test_wet_colors(scene):
    steps = []
    wet = gr.wet(scene, views=2, seed=3, progress=steps.append)
    assert wet.has_wet_colors and not scene.has_wet_colors and steps[-1].fraction == 1


def test_a_drive(tmp_path, scene):
    run = gr.drive(scene, gr.Rain(5), agent="constant-velocity")
    assert run.metrics.intensity_mm_h == 5 and run.metrics.collided is run.metrics.collision
    for named in run, run.rollout:
        assert "constant-velocity in 5 mm/h" in repr(named) and len(repr(named)) < 120
    run.save(tmp_path / "run.jsonl")
    assert gr.read_rollout(tmp_path / "run.jsonl") == run.rollout
    with pytest.raises(ValueError, match="no roll-out"):
        run._replace(rollout=None).save(tmp_path / "none.jsonl")
