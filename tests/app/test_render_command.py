"""`gsrain render` with the options of a recording, as a person types them."""

import json
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from PIL import Image, ImageCms

from app.command_line import BAD_INPUT, run
from gsrain_engine.scene.formats import write_scene
from gsrain_engine.scene.paths.camera_path import CameraPath
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


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--to", "0"], "--to must be above --from (0 s)"),
        (["--duration", "1", "--to", "1"], "--duration and --to exclude each other"),
        (["--cameras", "TOP"], "no camera 'TOP', only one/FRONT"),
        (["--passes", "colour"], "--passes: Invalid enum value 'colour', expected alpha, color, depth, labels"),
        (["--motion-blur", "65"], "--motion-blur: Expected `int` <= 64"),
        (["--codec", "vp9"], "vp9 needs an output that ends in .webm"),
        (["--quality", "64"], "--quality must be within 0..51"),
    ],
)
def test_bad_options_end_with_one_line_and_code_2(project, tmp_path, capsys, options, words):
    assert render(project, tmp_path / "a.mp4", *options) == BAD_INPUT
    said = capsys.readouterr().err.strip()
    assert said.startswith("gsrain: ")
    assert "\n" not in said
    assert words in said
    assert not (tmp_path / "a.mp4").exists()


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


def test_what_is_in_the_way_of_a_pass_is_told_before_anything_is_drawn(project, tmp_path, capsys):
    (tmp_path / "still.depth.png").mkdir()
    assert render(project, tmp_path / "still.png", "--depth") == BAD_INPUT
    assert "still.depth.png: can't be written, for it is a folder" in capsys.readouterr().err
    (tmp_path / "frames.clear").write_text("mine")
    assert render(project, tmp_path / "frames", "--twin", "--to", "0.1") == BAD_INPUT
    assert "frames.clear: can't be written, for it is a file" in capsys.readouterr().err
    assert sorted(each.name for each in tmp_path.iterdir()) == ["frames.clear", "still.depth.png"]
