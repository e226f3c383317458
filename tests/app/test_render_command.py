"""`gsrain render` with the options of a recording, as a person types them."""

import json
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from PIL import Image, ImageCms

from app.main import BAD_INPUT, run
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_io import read_camera_path
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from small_scene import small_scene


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A scene folder with a vehicle, a flight of one second from 1 s on, and rain."""
    facing = np.tile([0.5, -0.5, 0.5, -0.5], (2, 1))
    flight = CameraPath(np.array([1.0, 2.0]), np.array([[0.0, 0, 2], [6, 0, 2]]), facing, np.full(2, 50.0))
    folder = tmp_path_factory.mktemp("render") / "project"
    write_scene(replace(small_scene(), path=flight, rain={"intensity_mm_h": 8.5}), folder)
    return folder


def render(project, out, *options):
    return run(["render", str(project), "-o", str(out), "--size", "64x48", "--backend", "cpu", *options])


def test_a_project_is_flown_along_its_own_path_in_its_own_rain(project, tmp_path, capsys):
    numbers = tmp_path / "numbers.json"
    assert render(project, tmp_path / "all", "--fps", "4", "--json", str(numbers)) == 0
    report = json.loads(numbers.read_text())
    assert (report["frames"], report["intensity_mm_h"]) == (8, 8.5)  # from 0 s to the flight's end
    assert render(project, tmp_path / "late", "--fps", "4", "--from", "1", "--to", "1.75") == 0
    late = [path.read_bytes() for path in sorted((tmp_path / "late").iterdir())]
    assert late == [(tmp_path / "all" / f"{k:06d}.png").read_bytes() for k in (4, 5, 6)]
    assert len(set(late)) == 3
    assert render(project, tmp_path / "still.png", "--time", "1.5") == 0
    assert (tmp_path / "still.png").read_bytes() == late[2]


def test_cameras_passes_and_twin(project, tmp_path, capsys):
    options = ["--cameras", "one", "--passes", "color,labels", "--twin", "--to", "0.1", "--codec", "exr"]
    assert render(project, tmp_path / "rig", *options) == 0
    assert f"{tmp_path / 'rig'} and {tmp_path / 'rig.clear'}: 3 of 3 frames" in capsys.readouterr().out
    names = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*") if path.is_file()}
    frames = [f"00000{k}" for k in range(3)]
    assert names == {"rig/labels.json"} | {
        each for k in frames for each in (f"rig/{k}.exr", f"rig/{k}.labels.png", f"rig.clear/{k}.exr")
    }
    assert np.asarray(Image.open(tmp_path / "rig" / "000000.labels.png")).shape == (48, 64)


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


def test_a_still_of_photos_without_times_is_one_of_a_camera_at_rest(project, photos, tmp_path, capsys):
    options = ("--exposure", "0.02", "--json", str(tmp_path / "n.json"))
    flown = ("--camera-path", str(photos), "--rain", "50", *options)
    assert render(project, tmp_path / "still.npy", *flown) == 0
    assert "photos without times: the camera is at rest" in capsys.readouterr().out
    told = json.loads((tmp_path / "n.json").read_text())
    assert (told["speed_m_s"], told["speed_is_assumed"]) == (0.0, True)
    camera = read_camera_path(photos).camera(0.0, 64, 48)
    (tmp_path / "camera.json").write_text(json.dumps(camera.to_json()))
    standing = ("--camera", str(tmp_path / "camera.json"), "--rain", "50", *options)
    assert render(project, tmp_path / "standing.npy", *standing) == 0
    assert render(project, tmp_path / "fast.npy", *flown, "--speed", "14") == 0
    still, fast, same = (np.load(tmp_path / f"{name}.npy") for name in ("still", "fast", "standing"))
    slanted = np.abs(fast - same).max()
    assert slanted > 0.003 and np.abs(still - same).max() < 0.01 * slanted
    for name, asked in (("flown", flown), ("stood", standing)):
        assert render(project, tmp_path / f"{name}.npy", *asked, "--motion-blur", "2") == 0
    flown_blurred, stood_blurred = np.load(tmp_path / "flown.npy"), np.load(tmp_path / "stood.npy")
    assert np.abs(flown_blurred - stood_blurred).max() < 0.01 * slanted


def test_a_flight_along_photos_without_times_takes_walking_pace_or_a_speed(project, photos, tmp_path, capsys):
    numbers = tmp_path / "n.json"
    base = ("--camera-path", str(photos), "--fps", "1", "--rain", "0", "--json", str(numbers))
    assert render(project, tmp_path / "walk", *base) == 0
    assert "walking pace, 1.4 m/s, is assumed" in capsys.readouterr().out
    told = json.loads(numbers.read_text())
    assert (told["frames"], told["speed_m_s"], told["speed_is_assumed"]) == (9, 1.4, True)  # 12 m
    assert render(project, tmp_path / "drive", *base, "--speed", "3") == 0
    told = json.loads(numbers.read_text())
    assert (told["frames"], told["speed_m_s"], told["speed_is_assumed"]) == (4, 3.0, False)
    assert "walking" not in capsys.readouterr().out
    assert render(project, tmp_path / "own", "--fps", "2", "--json", str(numbers)) == 0
    assert json.loads(numbers.read_text())["speed_m_s"] is None  # that path has times of its own
    assert render(project, tmp_path / "own", "--fps", "2", "--speed", "1.5", "--json", str(numbers)) == 0
    assert json.loads(numbers.read_text())["frames"] == 10  # 6 m in 4 s, which begin at 1 s


def test_a_frame_of_a_path_is_a_still(project, tmp_path, capsys):
    assert render(project, tmp_path / "all", "--fps", "4") == 0
    assert render(project, tmp_path / "still.png", "--fps", "4", "--frame", "6") == 0
    assert (tmp_path / "still.png").read_bytes() == (tmp_path / "all" / "000006.png").read_bytes()


def test_a_frame_of_the_swing_around_a_scene_is_a_still(project, tmp_path):
    alone = tmp_path / "alone"
    write_scene(replace(read_scene(project), path=None, ego=None, rigs={}), alone)
    assert render(alone, tmp_path / "all", "--fps", "1", "--to", "4", "--rain", "0") == 0
    assert render(alone, tmp_path / "still.png", "--fps", "1", "--frame", "2", "--rain", "0") == 0
    assert (tmp_path / "still.png").read_bytes() == (tmp_path / "all" / "000002.png").read_bytes()
    assert render(alone, tmp_path / "front.png", "--rain", "0") == 0
    assert (tmp_path / "front.png").read_bytes() != (tmp_path / "still.png").read_bytes()


def test_an_ego_drives_along_photos_at_walking_pace_or_a_speed(project, photos, tmp_path, capsys):
    for name, asked, seconds in (("walk", [], 12 / 1.4), ("drive", ["--speed", "6"], 2.0)):
        assert run(["convert", str(project), str(tmp_path / name), "--drive", str(photos), *asked]) == 0
        assert ("walking pace" in capsys.readouterr().out) is (not asked)
        ego = read_scene(tmp_path / name).ego
        assert ego is not None and ego.times[-1] == pytest.approx(seconds, abs=0.01)
    assert run(["convert", str(project), str(tmp_path / "none"), "--speed", "6"]) == BAD_INPUT
    assert "--speed 6: is that of --drive" in capsys.readouterr().err


def test_jpegs_are_stills_and_frames_in_srgb(project, tmp_path, capsys):
    moment = ("--from", "1.5")
    assert render(project, tmp_path / "still.png", *moment) == 0
    for name in ("still.jpg", "again.JPEG"):
        assert render(project, tmp_path / name, *moment) == 0
    assert (tmp_path / "still.jpg").read_bytes() == (tmp_path / "again.JPEG").read_bytes()
    with Image.open(tmp_path / "still.jpg") as still, Image.open(tmp_path / "still.png") as lossless:
        profile = ImageCms.ImageCmsProfile(BytesIO(still.info["icc_profile"]))
        assert still.format == "JPEG" and "sRGB" in ImageCms.getProfileDescription(profile)
        assert np.abs(np.asarray(still, float) - np.asarray(lossless.convert("RGB"), float)).mean() < 2
    assert render(project, tmp_path / "frames", *moment, "--to", "1.56", "--codec", "jpeg", "--quality", "40") == 0
    frames = sorted((tmp_path / "frames").iterdir())
    assert [each.name for each in frames] == ["000000.jpg", "000001.jpg"]
    assert frames[0].stat().st_size < (tmp_path / "still.jpg").stat().st_size
    capsys.readouterr()
    assert render(project, tmp_path / "no.jpg", "--depth") == BAD_INPUT
    assert "no.jpg: JPEG holds colors alone; for the pass depth take PNG" in capsys.readouterr().err
