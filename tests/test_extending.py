"""Installs the package that docs/extending.md shows, and uses each of its extensions as the page says."""

import csv
import io
import re
import tomllib
from contextlib import redirect_stdout

import numpy as np
import pytest
from PIL import Image

from app.doctor import describe, installed_extensions
from app.main import BAD_INPUT, run
from extension_package import installed, titled_blocks
from gsrain_engine.api import Agent, Scenario, Simulation, open_agent, run_drive
from gsrain_engine.appearance.output_folder import read_transferred
from gsrain_engine.appearance.registry import usable_methods
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.plugins import GROUPS
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from repository import REPOSITORY
from small_scene import small_scene

PAGE = REPOSITORY / "docs" / "extending.md"
BLOCKS = titled_blocks(PAGE)
ENTRIES = tomllib.loads(BLOCKS["pyproject.toml"])["project"]["entry-points"]


@pytest.fixture(scope="module")
def rain_lab(tmp_path_factory):
    """The page's package, installed."""
    modules = {name: text for name, text in BLOCKS.items() if name.startswith("rain_lab/")}
    with installed(tmp_path_factory.mktemp("site"), "rain-lab", modules, ENTRIES):
        yield


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes") / "scene"
    write_scene(small_scene(), folder)
    return folder


def test_every_kind_of_extension_has_its_example_and_its_row():
    assert set(ENTRIES) == {group.name for group in GROUPS}
    text = PAGE.read_text(encoding="utf-8")
    rows = re.findall(r"^\| \[.*$", text, re.MULTILINE)
    assert {name for row in rows for name in re.findall(r"`(gsrain\.\w+)`", row)} == set(ENTRIES)
    named = {f"{each.partition(':')[0].replace('.', '/')}.py" for group in ENTRIES.values() for each in group.values()}
    assert named == {name for name in BLOCKS if name.startswith("rain_lab/")}


def test_a_scene_format_is_read_and_written(rain_lab, scene, tmp_path, capsys):
    scan = tmp_path / "scan.pts"
    assert run(["convert", str(scene), str(scan)]) == 0
    first, second = scan.read_text().splitlines()[:2]
    assert first == str(read_scene(scene).gaussian_count) and len(second.split()) == 7
    converted, flat = read_scene(scan), tmp_path / "flat.ply"
    write_scene(read_scene(scene), flat)
    expected, found = read_scene(flat).layers[0].gaussians, converted.layers[0].gaussians
    assert converted.name == "scan"
    away = found.means - expected.means
    assert np.abs(away - away.round()).max() < 2e-3  # moved by whole meters, for float32
    assert np.abs(found.sh[:, 0] - expected.sh[:, 0]).max() < 0.02
    scan.rename(tmp_path / "scan.xyz")
    scan.write_text("3\n1 2 3 0 255 255 255\n")
    (tmp_path / "empty.pts").write_text("nothing\n")
    for name, words in (
        ("scan.pts", "expected 3 points"),
        ("empty.pts", "pts (rain_lab.laser_scan:FORMAT of rain-lab): line"),
        ("scan.xyz", "meta.json or .pts"),
    ):
        assert run(["info", str(tmp_path / name)]) == BAD_INPUT
        error = capsys.readouterr().err
        assert name in error and words in error


def test_a_transfer_is_a_method(rain_lab, scene, tmp_path):
    options = ["--method", "mist", "--count", "1", "--width", "96"]
    assert run(["transfer", str(scene), "-o", str(tmp_path / "misty"), *options]) == 0
    (view,) = read_transferred(tmp_path / "misty")
    far = view.clear.depth > 20
    before, after = view.clear.image[far].std(), view.image[far].std()
    assert far.any() and after < 0.9 * before
    assert usable_methods()[-1].title == "Mist"


def test_an_agent_drives(rain_lab, scene):
    scenario = Scenario(name="empty road", scene=str(scene), speed_m_s=8.0, duration_s=2.0)
    agent = open_agent("gentle")
    rollout = run_drive(Simulation(scenario, read_scene(scene)), agent)
    assert isinstance(agent, Agent) and len(rollout.steps) > 4
    speeds = [step.ego.speed_m_s for step in rollout.steps]
    assert 8.0 == speeds[0] > speeds[-1] > 5.0  # it slows down to 6 m/s


def test_a_decoder_reads_what_a_detector_gives(rain_lab, tmp_path):
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    from evaluation.detection.tiny_onnx import write_constant
    from gsrain_engine.evaluation.detection.detector import open_detector

    logits = np.full((1, 5, 4), -9.0)
    logits[0, :, 3] = 3.0  # nothing
    logits[0, 2] = [0.0, 6.0, 0.0, 0.0]  # a truck
    boxes = np.tile([0.5, 0.25, 0.5, 0.25], (1, 5, 1))
    model = write_constant(tmp_path / "my_detr.onnx", [logits, boxes], (64, 96))
    (tmp_path / "my_detr.yaml").write_text(BLOCKS["my_detr.yaml"])
    (found,) = open_detector(model).detect(np.zeros((64, 96, 3), np.uint8))
    assert (found.class_name, found.confidence) == ("truck", pytest.approx(0.9926, abs=1e-3))
    assert found.box_xyxy == pytest.approx((24, 8, 72, 24), abs=1e-3)
    wrong = write_constant(tmp_path / "wrong.onnx", [logits], (64, 96))
    with pytest.raises(ValueError, match=r"wrong.onnx: expected logits \(1, queries, 4\)"):
        open_detector(wrong, tmp_path / "my_detr.yaml").detect(np.zeros((64, 96, 3), np.uint8))
    (tmp_path / "my_yolo.yaml").write_text(BLOCKS["my_yolo.yaml"])
    table = np.zeros((1, 7, 84))
    table[0, :, 40] = [48, 32, 40, 20, 0.1, 0.2, 0.9]
    (found,) = open_detector(write_constant(tmp_path / "my_yolo.onnx", [table], (64, 96))).detect(
        np.zeros((64, 96, 3), np.uint8)
    )
    assert (found.class_name, found.box_xyxy) == ("pedestrian", pytest.approx((28, 22, 68, 42)))


def test_a_rain_law_is_a_calibration(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    printed = io.StringIO()
    with redirect_stdout(printed):
        exec(compile(BLOCKS["thunderstorm.py"], "thunderstorm.py", "exec"), {})
    drops = float(printed.getvalue().split()[0])
    scale_mm = 8.5**0.21 / 3.0
    assert 0.4 < drops / (1400 * scale_mm) < 1.3  # those of 0.1 to 8 mm, and as many as make 8.5 mm/h
    assert (tmp_path / "thunderstorm.yaml").is_file()


def test_a_log_is_read(rain_lab, tmp_path, capsys):
    log = tmp_path / "our_log.csv"
    counts = [120, 90, 60, 40, 30, 10, 4, 1, 0]
    log.write_text(f"our drop counter\n2024-05-01T10:00,3.1,{','.join(map(str, counts))}\n")
    spectra = read_disdrometer(log).spectra
    middles = np.array([0.3, 0.5, 0.7, 0.9, 1.25, 1.75, 2.5, 3.5, 5.0])
    expected = np.dot(counts, np.pi / 6 * middles**3) / 5000 * 60  # mm3 on 5000 mm2, in an hour of such minutes
    assert spectra.rate_mm_h == pytest.approx([expected])
    log.write_text("our drop counter\n2024-05-01T10:00,3.1,1\n")
    assert run(["calibrate", str(log), "-o", str(tmp_path / "cal.yaml")]) == BAD_INPUT
    assert "our_log.csv: line 2: expected 11 fields, found 3" in capsys.readouterr().err


def test_a_capture_is_read(rain_lab, tmp_path, capsys):
    drive = tmp_path / "my_drive"
    drive.mkdir()
    for name, grey in (("one.png", 40), ("two.png", 90)):
        Image.new("RGB", (48, 32), (grey, grey, grey)).save(drive / name)
    with (drive / "poses.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("one.png", 0, 0, 0, 1.5, 90), ("two.png", 0.5, 0, 5, 1.5, 90)])
    assert capture_format(drive).name == "dash camera"  # and not a folder that only holds pictures
    capture = open_capture(drive)
    assert [int(view.image.mean()) for view in capture] == [40, 90]
    assert capture.views[1].camera.camera_to_world[:3, 2] == pytest.approx([0, 1, 0], abs=1e-9)
    (drive / "two.png").unlink()
    assert run(["info", str(drive)]) == BAD_INPUT
    assert "poses.csv: names two.png, which is not there" in capsys.readouterr().err


def test_an_evaluation_is_a_command(rain_lab, scene, capsys):
    assert run(["evaluate", "--help"]) == 0
    listed = capsys.readouterr().out
    assert re.search(r"contrast\s+Of the package rain-lab 0\.1\.0", listed) and "lidar" in listed
    assert run(["evaluate", "contrast", str(scene), "--rain", "8.5", "--rain", "50", "--width", "96"]) == 0
    shares = {line.split()[0]: float(line.split()[-1]) for line in capsys.readouterr().out.splitlines()}
    assert list(shares) == ["8.5", "50.0"] and shares["50.0"] < shares["8.5"] < 1
    assert run(["evaluate", "contrast", "--help"]) == 0
    assert "Fit a line through the pixels" in capsys.readouterr().out
    assert run(["evaluate", "contrast", "--wetness", "1"]) == BAD_INPUT


def test_all_of_them_are_fit(rain_lab):
    found = {each.name: describe(each) for each in installed_extensions()}
    places = {name: place for group in ENTRIES.values() for name, place in group.items()}
    assert found == {name: f"{place} of rain-lab 0.1.0" for name, place in places.items()}
