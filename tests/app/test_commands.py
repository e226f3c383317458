"""Each command as a person runs it, on small input."""

import json
import os
import signal
import subprocess
import sys

import av
import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import Layer, Scene


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A file with a colored wall of 900 Gaussians, 6 m ahead (+z), up is -y."""
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.linspace(-4, 4, 30), np.linspace(-3, 3, 30))
    n, f = x.size, np.float32
    wall = Gaussians(
        np.stack([x.ravel(), y.ravel(), np.full(n, 6.0)], axis=1).astype(f),
        np.full((n, 3), 0.2, f),
        np.tile(np.array([1, 0, 0, 0], f), (n, 1)),
        np.full(n, 0.95, f),
        sh_from_color(rng.uniform(0.1, 0.5, (n, 3)).astype(f)),
    )
    path = tmp_path_factory.mktemp("room") / "wall.ply"
    write_scene(Scene("wall", (Layer("wall", wall),), up=(0.0, -1.0, 0.0)), path)
    return path


def render(room, out, *options):
    return run(["render", str(room), "-o", str(out), "--size", "96x64", "--backend", "cpu", *options])


def test_render_writes_a_still_and_its_numbers(room, tmp_path, capsys):
    out, numbers = tmp_path / "still.png", tmp_path / "still.json"
    assert render(room, out, "--rain", "8.5", "--json", str(numbers)) == 0
    assert np.asarray(Image.open(out)).shape == (64, 96, 3)
    assert np.asarray(Image.open(out)).mean() > 20
    report = json.loads(numbers.read_text())
    assert {"frames", "seconds", "splats", "drops", "drops_drawn", "haze_gaussians", "haze_drawn", "backend",
            "intensity_mm_h", "implied_mm_h"} <= set(report)  # fmt: skip
    assert (report["frames"], report["intensity_mm_h"], report["implied_mm_h"]) == (1, 8.5, 8.5)
    assert report["drops"] == 331_752
    assert report["haze_gaussians"] == 713  # beta V_f / (2 pi s_h^2 alpha_m)
    assert str(out) in capsys.readouterr().out


def test_no_rain_is_byte_identical_to_zero_rain(room, tmp_path):
    paths = [tmp_path / name for name in ("without.npy", "zero.npy", "some.npy")]
    for path, options in zip(paths, ([], ["--rain", "0"], ["--rain", "5"]), strict=True):
        assert render(room, path, *options) == 0
    without, zero, some = (path.read_bytes() for path in paths)
    assert without == zero
    assert some != zero


def test_frame_40_alone_is_frame_40_of_the_sequence(room, tmp_path):
    folder = tmp_path / "frames"
    assert render(room, folder, "--rain", "8.5", "--fps", "10", "--duration", "4.2") == 0
    assert len(list(folder.glob("*.png"))) == 42
    alone = tmp_path / "alone"
    assert render(room, alone, "--rain", "8.5", "--fps", "10", "--frame", "40") == 0
    assert (alone / "000040.png").read_bytes() == (folder / "000040.png").read_bytes()
    assert (folder / "000039.png").read_bytes() != (folder / "000040.png").read_bytes()


def test_video_plays_and_is_repeatable(room, tmp_path):
    paths = [tmp_path / name for name in ("a.mp4", "b.mp4")]
    for path in paths:
        assert render(room, path, "--rain", "4", "--duration", "0.5") == 0
    with av.open(str(paths[0])) as container:
        assert sum(1 for _ in container.decode(video=0)) == 15
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_camera_and_depth_are_in_the_scene_s_own_axes(room, tmp_path):
    camera = Camera(96, 64, 80.0, 80.0, 48.0, 32.0, look_at(np.zeros(3), np.array([0, 0, 1.0]), np.array([0, -1.0, 0])))
    file = tmp_path / "camera.json"
    file.write_text(json.dumps(camera.to_json()))
    out = tmp_path / "view.npy"
    command = ["render", str(room), "-o", str(out), "--camera", str(file), "--depth", "--backend", "cpu"]
    assert run(command) == 0
    assert np.load(out).shape == (64, 96, 4)
    assert np.load(tmp_path / "view.depth.npy")[32, 48] == pytest.approx(6.0, abs=0.1)
    assert run([*command, "--metres-per-unit", "2", "--up", "-y"]) == 0
    assert np.load(tmp_path / "view.depth.npy")[32, 48] == pytest.approx(12.0, abs=0.2)


def test_wet_look_changes_the_scene(room, tmp_path):
    dry, wet = tmp_path / "dry.png", tmp_path / "wet.png"
    assert render(room, dry) == 0
    assert render(room, wet, "--wet") == 0
    difference = np.asarray(Image.open(dry)).astype(int) - np.asarray(Image.open(wet))
    assert np.abs(difference).mean() > 0.5  # a wall in the dark, which has no sun to lose


def test_ctrl_c_leaves_a_playable_video(room, tmp_path):
    out = tmp_path / "stopped.mp4"
    # A shell without job control starts its background commands deaf to Ctrl-C, and their children with them.
    listen = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = [sys.executable, "-c", f"{listen}\nfrom app.__main__ import main\nmain()", "render", str(room)]
    command += ["-o", str(out), "--size", "96x64", "--backend", "cpu", "--duration", "600"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "NO_COLOR": "1"}) as process:
        while not out.exists() or out.stat().st_size < 20_000:
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(0.1)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=60)[0]
    assert process.returncode == 130
    assert "stopped after" in said
    with av.open(str(out)) as container:
        assert sum(1 for _ in container.decode(video=0)) > 10


def test_info_reports_what_is_in_a_scene(room, tmp_path, capsys):
    numbers = tmp_path / "info.json"
    assert run(["info", str(room), "--json", str(numbers)]) == 0
    report = json.loads(numbers.read_text())
    assert report["gaussians"] == 900
    assert report["members"][0]["minimum"] == [-4, -3, 6]
    assert (
        report["shell"] is None and np.ptp([report["core_m"][end] for end in ("minimum", "maximum")], axis=0).min() > 0
    )
    assert "900" in capsys.readouterr().out


def test_convert_says_which_way_is_up_and_how_long_a_metre_is(room, tmp_path):
    before = read_scene(room).layers[0].gaussians.means
    options = ["--up", "z", "--metres-per-unit", "2.5"]
    assert run(["convert", str(room), str(tmp_path / "folder"), *options]) == 0
    said = read_scene(tmp_path / "folder")
    assert (said.up, said.metres_per_unit) == ((0.0, 0.0, 1.0), 2.5)
    np.testing.assert_array_equal(said.layers[0].gaussians.means, before)
    assert run(["convert", str(room), str(tmp_path / "baked.ply"), *options]) == 0
    baked = read_scene(tmp_path / "baked.ply").layers[0].gaussians.means
    x, y, z = before.T  # what was up, z, is now where files have it: -y
    np.testing.assert_allclose(baked[:, 1], -2.5 * z, rtol=1e-5)
    np.testing.assert_allclose(np.hypot(baked[:, 0], baked[:, 2]), 2.5 * np.hypot(x, y), rtol=1e-5)


@pytest.mark.parametrize("suffix", [".splat", ".spz", ".ply", ""])
def test_convert_keeps_the_scene(room, tmp_path, suffix):
    target = tmp_path / f"wall2{suffix}"
    assert run(["convert", str(room), str(target), "--json", str(tmp_path / "numbers.json")]) == 0
    assert json.loads((tmp_path / "numbers.json").read_text()) == {"gaussians": 900, "left_out": 0}
    before, after = (read_scene(path).layers[0].gaussians for path in (room, target))
    assert len(after) == 900
    assert np.allclose(np.sort(after.means[:, 0]), np.sort(before.means[:, 0]), atol=1e-3)


def test_street_writes_scene_and_photographs(tmp_path, capsys):
    assert run(["street", str(tmp_path), "--moments", "1", "--width", "96"]) == 0
    scene = read_scene(tmp_path / "scene")
    assert 200_000 <= scene.gaussian_count <= 410_000
    assert {"waymo_front3", "nuscenes"} == set(scene.rigs)
    cameras = json.loads((tmp_path / "images" / "cameras.json").read_text())
    assert len(cameras) == 3
    depth = np.load(tmp_path / "images" / f"{cameras[0]['name']}.depth.npy")
    labels = np.asarray(Image.open(tmp_path / "images" / f"{cameras[0]['name']}.labels.png"))
    assert depth.shape == labels.shape == (64, 96)
    assert len(np.unique(labels)) >= 4


def test_without_a_display_the_window_says_so(room, monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert run([str(room)]) == BAD_INPUT
    assert "no display" in capsys.readouterr().err


def test_a_display_that_is_not_there_is_told(room):
    environment = os.environ | {"DISPLAY": ":99999"}
    environment.pop("WAYLAND_DISPLAY", None)
    command = [sys.executable, "-m", "app", str(room)]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == BAD_INPUT
    assert ended.stderr.strip().startswith("gsrain: the display can't be opened")
