"""`gsrain render`: stills, frames and videos, cameras and paths, weather, wet colors and passes."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from io import BytesIO

import av
import msgspec
import numpy as np
import pytest
from PIL import Image, ImageCms

from app.main import BAD_INPUT, run
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_io import read_camera_path
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.scene import Layer, Scene
from night_scene import night_scene
from small_scene import patch, small_scene

EXTINCTION = "extinction_per_m", "meteorological_range_m", "airlight_linear"
CONTRACT = {
    "frames", "seconds", "splats", "drops", "drops_drawn", "haze_gaussians", "backend", "intensity_mm_h",
    "implied_mm_h",
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("render")


@pytest.fixture(scope="module")
def wall(folder):
    """A file with a wall 6 m ahead (+z), up is -y."""
    wall = patch((-4, -3, 6), np.array([8.0, 0, 0]), np.array([0, 6.0, 0]), 20, (0.7, 0.45, 0.3))
    write_scene(Scene("wall", (Layer("wall", wall),), up=(0.0, -1.0, 0.0)), folder / "wall.ply")
    return folder / "wall.ply"


@pytest.fixture(scope="module")
def project(folder):
    """A scene folder with a vehicle, a flight of one second from 1 s on, and rain."""
    facing = np.tile([0.5, -0.5, 0.5, -0.5], (2, 1))
    flight = CameraPath(np.array([1.0, 2.0]), np.array([[0.0, 0, 2], [6, 0, 2]]), facing, np.full(2, 50.0))
    write_scene(replace(small_scene(), path=flight, rain={"intensity_mm_h": 8.5}), folder / "project")
    return folder / "project"


@pytest.fixture
def photos(tmp_path):
    """3DGS's cameras.json: five photos without times, 3 m one from the other."""
    rows = [
        {"img_name": f"{k}", "width": 64, "height": 48, "position": [3.0 * k, 0.0, 2.0], "fx": 800, "fy": 800,
         "rotation": [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]}
        for k in range(5)
    ]  # fmt: skip
    (tmp_path / "cameras.json").write_text(json.dumps(rows))
    return tmp_path / "cameras.json"


def words(scene, out, *options):
    command = ["render", str(scene), "-o", str(out), "--size", "64x48", "--backend", "cpu"]
    return [*command, *map(str, options)]


def render(scene, out, *options):
    assert run(words(scene, out, *options)) == 0
    return out


def mean(file):
    return np.asarray(Image.open(file)).mean()


def test_a_still_and_its_numbers(wall, tmp_path, reported, capsys):
    out = tmp_path / "still.png"
    report = reported(*words(wall, out, "--rain", "8.5"))
    assert np.asarray(Image.open(out)).shape == (48, 64, 3) and mean(out) > 20
    assert set(report) >= CONTRACT
    assert (report["frames"], report["intensity_mm_h"], report["implied_mm_h"]) == (1, 8.5, 8.5)
    assert report["drops"] == 340_545
    assert report["rain_class"] == "heavy"
    assert report["haze_gaussians"] == 0  # haze is a medium
    assert report["extinction_per_m"] == pytest.approx(1.87e-3, rel=0.01)
    assert report["marshall_palmer_extinction_per_m"] == pytest.approx(1.25e-3, rel=0.01)
    assert "extinction 1.87 /km (1.5 times Marshall-Palmer's)" in capsys.readouterr().out
    assert report["meteorological_range_m"] == pytest.approx(np.log(20) / report["extinction_per_m"])
    assert len(report["airlight_linear"]) == 3 and all(0 < each < 1 for each in report["airlight_linear"])
    paper = reported(*words(wall, out, "--preset", "paper"))
    assert (paper["haze_gaussians"], paper["airlight_linear"]) == (553, None)  # beta V_f / (2 pi s_h^2 alpha_m)
    dry = reported(*words(wall, out))
    assert [dry[name] for name in EXTINCTION] == [0, None, None]
    assert str(out) in capsys.readouterr().out
    without, zero, some = (
        render(wall, tmp_path / f"{name}.npy", *options).read_bytes()
        for name, options in (("without", ()), ("zero", ("--rain", "0")), ("some", ("--rain", "5")))
    )
    assert without == zero != some
    assert abs(mean(render(wall, tmp_path / "wet.png", "--wet")) - mean(render(wall, tmp_path / "dry.png"))) > 0.5


def test_a_project_is_flown_along_its_own_path_in_its_own_rain(project, tmp_path, reported):
    report = reported(*words(project, tmp_path / "all", "--fps", "4"))
    assert (report["frames"], report["intensity_mm_h"]) == (8, 8.5)  # from 0 s to the flight's end
    late = render(project, tmp_path / "late", "--fps", "4", "--from", "1", "--to", "1.75")
    frames = [path.read_bytes() for path in sorted(late.iterdir())]
    assert frames == [(tmp_path / "all" / f"{k:06d}.png").read_bytes() for k in (4, 5, 6)] and len(set(frames)) == 3
    assert render(project, tmp_path / "still.png", "--time", "1.5").read_bytes() == frames[2]


def test_a_frame_alone_is_that_of_the_sequence(wall, project, tmp_path):
    alone = tmp_path / "alone scene"
    write_scene(replace(read_scene(project), path=None, ego=None, rigs={}), alone)  # the camera swings around it
    for number, (scene, frame, options) in enumerate((
        (wall, 12, ("--rain", "8.5", "--fps", "10", "--duration", "1.4")),
        (project, 6, ("--fps", "4")),
        (alone, 2, ("--fps", "1", "--to", "4", "--rain", "0")),
    )):  # fmt: skip
        frames = render(scene, tmp_path / f"frames{number}", *options)
        has_path = scene is project  # of the swing around others a still shows no frame
        still = tmp_path / f"still{number}.png" if has_path else tmp_path / f"still{number}" / f"{frame:06}.png"
        render(scene, still if has_path else still.parent, *options, "--frame", frame)
        assert still.read_bytes() == (frames / f"{frame:06}.png").read_bytes()
        assert still.read_bytes() != (frames / f"{frame - 1:06}.png").read_bytes()
    assert len(list((tmp_path / "frames0").glob("*.png"))) == 14
    assert render(alone, tmp_path / "front.png", "--rain", "0").read_bytes() != still.read_bytes()


def test_a_video_is_repeatable_and_ctrl_c_leaves_a_playable_one(wall, tmp_path):
    first, second = (render(wall, tmp_path / name, "--rain", "4", "--duration", "0.5") for name in ("a.mp4", "b.mp4"))
    with av.open(str(first)) as container:
        assert sum(1 for _ in container.decode(video=0)) == 15
    assert first.read_bytes() == second.read_bytes()
    out = tmp_path / "stopped.mp4"
    # A shell without job control starts its background commands deaf to Ctrl-C, and their children with them.
    listen = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = [sys.executable, "-c", f"{listen}\nfrom app.__main__ import main\nmain()", *words(wall, out)]
    environment = {**os.environ, "NO_COLOR": "1"}
    with subprocess.Popen(
        [*command, "--duration", "600"], stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        while not out.exists() or out.stat().st_size < 20_000:
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(0.1)
        process.send_signal(signal.SIGINT)
        printed = process.communicate(timeout=60)[0]
    assert process.returncode == 130 and "stopped after" in printed
    with av.open(str(out)) as container:
        assert sum(1 for _ in container.decode(video=0)) > 10


def test_camera_and_depth_are_in_the_scene_s_own_axes(wall, tmp_path):
    camera = Camera(64, 48, 60.0, 60.0, 32.0, 24.0, look_at(np.zeros(3), np.array([0, 0, 1.0]), np.array([0, -1.0, 0])))
    (tmp_path / "camera.json").write_text(json.dumps(camera.to_json()))
    options = ("--camera", tmp_path / "camera.json", "--depth")
    assert np.load(render(wall, tmp_path / "view.npy", *options)).shape == (48, 64, 4)
    assert np.load(tmp_path / "view.depth.npy")[24, 32] == pytest.approx(6.0, abs=0.1)
    render(wall, tmp_path / "view.npy", *options, "--meters-per-unit", "2", "--up", "-y")
    assert np.load(tmp_path / "view.depth.npy")[24, 32] == pytest.approx(12.0, abs=0.2)


def test_a_camera_is_two_places_in_the_world(wall, tmp_path, capsys):
    up = ("--up", "-y", "--depth")  # the wall's z axis points ahead: y in the world
    render(wall, tmp_path / "view.npy", "--camera", "0,-2,0,0,5,0", *up)
    assert np.load(tmp_path / "view.depth.npy")[24, 32] == pytest.approx(8.0, abs=0.1)
    capsys.readouterr()
    for wrong in ("0,0,1", "0,0,1,0,0,1", "a,b,c,d,e,f", "0,0,nan,0,0,1"):
        assert run(["render", str(wall), "-o", str(tmp_path / "none.png"), "--camera", wrong]) == BAD_INPUT
        (line,) = capsys.readouterr().err.splitlines()
        assert f"--camera {wrong}: expected a file, or six numbers" in line


def test_cameras_passes_and_twin(project, tmp_path, capsys):
    out, options = (
        tmp_path / "rig",
        ("--cameras", "one", "--passes", "color,labels", "--clear-pair=sunny", "--to", "0.1"),
    )
    render(project, out, *options, "--codec", "exr")
    assert f"{out} and {tmp_path / 'rig.clear'}: 3 of 3 frames" in capsys.readouterr().out
    names = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*") if path.is_file()}
    frames = [f"00000{k}" for k in range(3)]
    assert names == {"rig/labels.json", "rig.provenance.json"} | {
        each for k in frames for each in (f"rig/{k}.exr", f"rig/{k}.labels.png", f"rig.clear/{k}.exr")
    }
    assert np.asarray(Image.open(out / "000000.labels.png")).shape == (48, 64)


def test_a_still_of_photos_without_times_is_one_of_a_camera_at_rest(project, photos, tmp_path, reported, capsys):
    options = ("--exposure", "0.02", "--rain", "50")
    flown = ("--camera-path", photos, *options)
    report = reported(*words(project, tmp_path / "still.npy", *flown))
    assert "photos without times: the camera is at rest" in capsys.readouterr().out
    assert (report["speed_m_s"], report["speed_is_assumed"]) == (0.0, True)
    camera = read_camera_path(photos).camera(0.0, 64, 48)
    (tmp_path / "camera.json").write_text(json.dumps(camera.to_json()))
    standing = ("--camera", tmp_path / "camera.json", *options)
    still = np.load(tmp_path / "still.npy")
    fast = np.load(render(project, tmp_path / "fast.npy", *flown, "--speed", "14"))
    same = np.load(render(project, tmp_path / "standing.npy", *standing))
    slanted = np.abs(fast - same).max()
    assert slanted > 0.001 and np.abs(still - same).max() < 0.01 * slanted
    flown_blurred, stood_blurred = (
        np.load(render(project, tmp_path / f"{name}.npy", *given, "--motion-blur", "2"))
        for name, given in (("flown", flown), ("stood", standing))
    )
    assert np.abs(flown_blurred - stood_blurred).max() < 0.01 * slanted


def test_speeds_of_paths_and_drives_along_photos(project, photos, tmp_path, reported, capsys):
    flown, own = ("--camera-path", photos, "--fps", "1", "--rain", "0"), ("--fps", "2")
    for name, options, (frames, speed, is_assumed) in (
        ("walk", flown, (9, 1.4, True)),  # 12 m
        ("fast", (*flown, "--speed", "3"), (4, 3.0, False)),
        ("own", own, (4, None, False)),  # that path has times of its own
        ("slow", (*own, "--speed", "1.5"), (10, 1.5, False)),  # 6 m in 4 s, which begin at 1 s
    ):
        report = reported(*words(project, tmp_path / f"frames of {name}", *options))
        assert (report["frames"], report["speed_m_s"], report["speed_is_assumed"]) == (frames, speed, is_assumed)
        assert ("walking pace, 1.4 m/s, is assumed" in capsys.readouterr().out) is is_assumed
    for name, options, seconds in (("walk", [], 12 / 1.4), ("drive", ["--speed", "6"], 2.0)):
        assert run(["convert", str(project), str(tmp_path / name), "--drive", str(photos), *options]) == 0
        assert ("walking pace" in capsys.readouterr().out) is (not options)
        assert read_scene(tmp_path / name).ego.times[-1] == pytest.approx(seconds, abs=0.01)


def test_jpegs_are_stills_and_frames_in_srgb(project, tmp_path):
    moment = ("--from", "1.5")
    first, second, png = (render(project, tmp_path / name, *moment) for name in ("a.jpg", "b.JPEG", "still.png"))
    assert first.read_bytes() == second.read_bytes()
    with Image.open(first) as still, Image.open(png) as lossless:
        profile = ImageCms.ImageCmsProfile(BytesIO(still.info["icc_profile"]))
        assert still.format == "JPEG" and "sRGB" in ImageCms.getProfileDescription(profile)
        assert np.abs(np.asarray(still, float) - np.asarray(lossless.convert("RGB"), float)).mean() < 2
    render(project, tmp_path / "frames", *moment, "--to", "1.56", "--codec", "jpeg", "--quality", "40")
    frames = sorted((tmp_path / "frames").iterdir())
    assert [each.name for each in frames] == ["000000.jpg", "000001.jpg"]
    assert frames[0].stat().st_size < first.stat().st_size


def test_the_weather_of_a_scene_and_what_replaces_it(tmp_path, reported, capsys):
    keys = (RainKeyframe(time_s=0.0, intensity_mm_h=0.0), RainKeyframe(time_s=2.0, intensity_mm_h=10.0))
    rain, weather = RainSettings(intensity_mm_h=50.0, seed=4), RainKeyframes(keys=keys)
    shower = tmp_path / "shower"
    write_scene(
        replace(small_scene(), rain=msgspec.to_builtins(rain), weather=msgspec.to_builtins(weather)), shower
    )  # fmt: skip

    def frame(time, *options):
        report = reported(*words(shower, tmp_path / "still.npy", "--time", time, *options))
        return np.load(tmp_path / "still.npy"), report

    wet, report = frame(1.5)
    assert report["intensity_mm_h"] == pytest.approx(7.5) and report["drops"] > 0
    assert "a weather with 2 keys" in capsys.readouterr().out
    assert not np.array_equal(wet, frame(1.5, "--rain", "0")[0])
    assert np.array_equal(frame(0)[0], frame(0, "--rain", "0")[0])
    for options, expected in ((("--rain", "3"), 3.0), (("--preset", "1.2"), 1.2), (("--seed", "9"), 5.0)):
        assert frame(1, *options)[1]["intensity_mm_h"] == pytest.approx(expected)


def test_the_visible_distance_grows_with_the_focal_length_and_needs_rain(tmp_path, reported, capsys):
    """Equation 6: 1.5 mm at 2000 px are the paper's 3 m."""
    write_scene(small_scene(), tmp_path / "scene")
    words = ("render", tmp_path / "scene", "-o", tmp_path / "still.png", "--backend", "cpu")
    (small,), (large,) = (
        reported(*words, "--preset", "paper", "--size", size)["visible_distance"] for size in ("96x64", "192x128")
    )
    for each in (small, large):
        assert each["large_drop_m"] == pytest.approx(each["focal_px"] * 1.5e-3, rel=0.01)
        assert each["large_drop_haze_m"] == pytest.approx(2 * each["large_drop_m"])
        assert each["median_volume_drop_m"] == pytest.approx(each["focal_px"] * 1.117e-3, rel=0.01)
    assert large["focal_px"] == pytest.approx(2 * small["focal_px"])
    printed = capsys.readouterr().out
    assert f"(focal length {small['focal_px']:.0f} px) up to {small['large_drop_m']:.2f} m away" in printed
    assert reported(*words, "--rain", "0", "--size", "96x64")["visible_distance"] == []
    assert "visible distance" not in capsys.readouterr().out


def test_a_scene_gets_as_wet_as_it_rains_or_as_wet_as_asked(tmp_path):
    scene = small_scene()
    for each in scene.layers[:2]:
        scene = scene.with_member(each.key, wet_sh=each.gaussians.sh - np.float32(0.6))
    write_scene(scene, tmp_path / "wet")
    clear, light, wet, soaked, dry = (
        mean(render(tmp_path / "wet", tmp_path / f"{number}.png", "--no-streaks", "--no-haze", *options))
        for number, options in enumerate((
            (), ("--rain", "0.4"), ("--rain", "2.5"), ("--wetness", "1"), ("--rain", "12", "--no-wet")
        ))
    )  # fmt: skip
    assert wet < light - 3 < clear - 6
    assert soaked < wet < soaked + 5
    assert dry == pytest.approx(clear, abs=0.01)


def test_a_sensor_by_name_and_by_file(project, wall, tmp_path, capsys):
    """Twins have the same noise; a sensor that is not there, or is wrong, costs one line."""
    render(project, tmp_path / "seen", "--sensor", "automotive", "--clear-pair", "sunny", "--rain", "0", "--to", "0.1")
    seen, twin, plain = (
        [file.read_bytes() for file in sorted((tmp_path / name).iterdir())]
        for name in ("seen", "seen.clear", render(project, tmp_path / "plain", "--rain", "0", "--to", "0.1").name)
    )
    assert seen == twin != plain
    own = tmp_path / "mine.yaml"
    own.write_text("{full_well_e: 500, read_noise_e: 20}")
    assert (
        render(wall, tmp_path / "own.png", "--sensor", own).read_bytes()
        != render(wall, tmp_path / "a.png").read_bytes()
    )
    own.write_text("f_number: 0.1")
    for wrong, words_of_it in (
        ("nikon", "none of the shipped ones"),
        (own, "0.1 must be at least 0.7 - at `$.f_number`"),
    ):
        capsys.readouterr()
        assert run(words(wall, tmp_path / "b.png", "--sensor", wrong)) == 2
        error = capsys.readouterr().err.strip()
        assert words_of_it in error and "\n" not in error
        assert not (tmp_path / "b.png").exists()


def test_lamps_are_found_or_left_out(tmp_path, capsys):
    scene = replace(night_scene(), ego=small_scene().ego, rigs=small_scene().rigs)
    write_scene(scene, tmp_path / "night")
    images = {}
    for choice in ("auto", "none"):
        image, numbers = tmp_path / f"{choice}.png", tmp_path / f"{choice}.json"
        options = ["--visibility", "80", "--lamps", choice, "--size", "64x40", "--backend", "cpu"]
        assert run(["render", str(tmp_path / "night"), *options, "-o", str(image), "--json", str(numbers)]) == 0
        assert json.loads(numbers.read_text())["lamps"] == (choice == "auto")
        assert ("1 lamp found" in capsys.readouterr().out) == (choice == "auto")
        images[choice] = np.asarray(Image.open(image)).astype(int)
    assert (images["auto"] - images["none"]).max() > 10
    assert run(["render", "street", "--lamps", "candles", "-o", str(tmp_path / "no.png")]) == 2
    assert "candles: no such file, and none of none, auto, headlights" in capsys.readouterr().err
