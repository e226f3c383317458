"""`gsrain evaluate streaks` on sequences in RainSense's layout."""

import json

import numpy as np
import pytest
from PIL import Image

from app.main import run
from gsrain_engine.scene.sensor import load_sensor

WIDTH, HEIGHT, FRAMES = 256, 192, 8
INTRINSICS = """K_cam:
400.0 0.0 128.0
0.0 402.0 160.0
0.0 0.0 1.0
distortion:
-0.4 0.05 -0.006 0.007 2.5e-01
"""


def write_sequence(folder, intensity):
    """Gray walls under a bright sky, with noise; frame 3 has one bright upright line."""
    random = np.random.default_rng(7)
    (folder / "context").mkdir(parents=True)
    (folder / "image").mkdir()
    (folder / "context" / "rainfall_intensity.txt").write_text(f"current intensity:{intensity}")
    (folder / "context" / "camera_intrinsics.txt").write_text(INTRINSICS)
    stamps = [f"{1000 + 0.1 * k:.4f},{k}" for k in range(FRAMES + 2)]
    (folder / "timestamps.txt").write_text("\n".join(["timestamps,index", *stamps]))
    for number in range(FRAMES):
        levels = np.full((HEIGHT, WIDTH), 45.0)
        levels[:40] = 210
        if number == 3:
            levels[80:120, 100:104] += 20
        gray = np.clip(levels + 1.2 * random.standard_normal(levels.shape), 0, 255).astype(np.uint8)
        Image.fromarray(np.dstack([gray] * 3)).save(folder / "image" / f"image_{number:03}.jpg", quality=97)


@pytest.fixture
def real(tmp_path):
    """Two sequences, the heavier first by name."""
    write_sequence(tmp_path / "set" / "a" / "case_000", 6.0)
    write_sequence(tmp_path / "set" / "b" / "case_000", 1.5)
    return tmp_path / "set"


def test_streaks_of_real_and_rendered_rain(real, reported, capsys):
    options = ("--exposure", "0.008,0.02", "--frames", "7")
    report = reported("evaluate", "streaks", real, *options)
    assert (report["frames"], report["model"], report["seed"]) == (7, "physical", 0)
    assert [row["labelled_mm_h"] for row in report["rows"]] == [1.5, 6.0]
    for row in report["rows"]:
        assert row["rendered_mm_h"] == row["labelled_mm_h"]
        assert row["window"] == [0, 0, WIDTH, 160]  # down to the horizon
        assert row["sky_levels"] == pytest.approx(210, abs=3)
        assert [each["exposure_s"] for each in (row["real"], *row["ours"])] == [None, 0.008, 0.02]
        streak = row["real"]["streak"]
        assert (streak["streaks"], streak["darker"]) == (1, 0)
        assert streak["length_px"][1] == pytest.approx(40, rel=0.15)
        assert row["real"]["residual"]["frames"] == 7
        assert row["ours"][0]["streak"]["streaks"] > 0
    printed = capsys.readouterr().out
    assert (printed.count("real"), printed.count("ours")) == (2, 4)
    (row,) = reported("evaluate", "streaks", real / "b", *options)["rows"]
    assert row == report["rows"][0] | {"sequence": row["sequence"]}


PINHOLE = ("--sensor", "pinhole")


def test_options_change_the_rendered_rain(real, reported):
    def mean_std(*options):
        (row,) = reported(
            "evaluate", "streaks", real / "b", "--exposure", "0.008", "--window", "0,48,256,128", *PINHOLE, *options
        )["rows"]
        assert row["window"] == [0, 48, 256, 128]
        return row["rendered_mm_h"], row["ours"][0]["residual"]["std_levels"]

    (labelled, plain), (none, clear) = mean_std(), mean_std("--rain", "0")
    assert (labelled, none) == (1.5, 0)
    assert plain > clear + 0.02
    assert mean_std("--streak-gain", "4")[1] > plain + 0.05
    assert mean_std("--model", "paper")[1] < plain - 0.01
    assert mean_std("--aperture", "8")[1] < plain - 0.01
    assert mean_std("--seed", "1")[1] != plain


def test_report_and_unlabeled_pairs(real, reported, tmp_path, monkeypatch):
    monkeypatch.setattr("gsrain_extras.real_rain.pairs.PAIR_CROP", (100, 80))
    monkeypatch.setattr("gsrain_extras.real_rain.pairs.PAIRS", 6)
    conditions = tmp_path / "days.yaml"
    conditions.write_text("sequences: [{intensity_mm_h: 6.0, shutter_s: 0.012, wind_speed_m_s: 0, middle_frame: 4}]")
    page, pairs = tmp_path / "page.md", tmp_path / "pairs"
    options = ("--conditions", conditions, "--report", page, "--pairs", pairs, "--frames", "6")
    light, heavy = reported("evaluate", "streaks", real, *options)["rows"]
    assert (light["ours"][0]["exposure_s"], heavy["ours"][0]["exposure_s"]) == (0.008, 0.012)
    assert (light["numbers"], heavy["numbers"]) == ([1, 2, 3, 4, 5, 6], [2, 3, 4, 5, 6, 7])
    text = page.read_text()
    assert "|  | 1.5 mm/h, real | 1.5 mm/h, ours |" in text and "| Shutter of ours, ms | - | 8 | - | 12 |" in text
    key = json.loads((tmp_path / "pairs_key.json").read_text())["pairs"]
    assert [each["picture"] for each in key] == sorted(each.name for each in pairs.iterdir())
    assert len(key) == 6 and {each["real"] for each in key} <= {"left", "right"}
    with Image.open(pairs / key[0]["picture"]) as picture:
        assert picture.size == (212, 80)
        pixels = np.asarray(picture.convert("RGB"))
    assert not np.array_equal(pixels[:, :100], pixels[:, 112:]) and (pixels[:, 100:112] == 255).all()


def test_the_sensor_is_fitted_to_frames_without_rain(real, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("gsrain_extras.real_rain.camera_noise.FIT_TRIALS", 12)
    write_sequence(tmp_path / "clear", 0)
    file = tmp_path / "mine.yaml"
    assert run(["evaluate", "streaks", str(tmp_path / "clear"), "--frames", "7", "--fit-sensor", str(file)]) == 0
    own, fitted = load_sensor("rainsense"), load_sensor(file)
    assert (fitted.f_number, fitted.tone_curve) == (own.f_number, "crushed")
    assert 1 <= fitted.gain <= 256 and fitted != own
    assert run(["evaluate", "streaks", str(real), "--fit-sensor", str(file)]) == 2
    assert "takes a sequence without rain" in capsys.readouterr().err
