"""`gsrain evaluate streaks` on a small made-up data set in RainSense's layout, and on bad input."""

import json

import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from gsrain_engine.datasets.rainsense import find_rain_sequences

WIDTH, HEIGHT, FRAMES = 256, 192, 8
INTRINSICS = """K_cam:
400.0 0.0 128.0
0.0 402.0 160.0
0.0 0.0 1.0
distortion:
-0.4 0.05 -0.006 0.007 2.5e-01
"""


def write_sequence(folder, intensity, frames=FRAMES):
    """Grey walls under a bright sky, with noise; frame 3 has one bright upright line."""
    random = np.random.default_rng(7)
    (folder / "context").mkdir(parents=True)
    (folder / "image").mkdir()
    (folder / "context" / "rainfall_intensity.txt").write_text(f"current intensity:{intensity}")
    (folder / "context" / "camera_intrinsics.txt").write_text(INTRINSICS)
    stamps = [f"{1000 + 0.1 * k:.4f},{k}" for k in range(frames + 2)]
    (folder / "timestamps.txt").write_text("\n".join(["timestamps,index", *stamps]))
    for number in range(frames):
        levels = np.full((HEIGHT, WIDTH), 45.0)
        levels[:40] = 210
        if number == 3:
            levels[80:120, 100:104] += 20
        grey = np.clip(levels + 1.2 * random.standard_normal(levels.shape), 0, 255).astype(np.uint8)
        Image.fromarray(np.dstack([grey] * 3)).save(folder / "image" / f"image_{number:03}.jpg", quality=97)


@pytest.fixture
def real(tmp_path):
    """Two sequences, the heavier first by name."""
    write_sequence(tmp_path / "set" / "a" / "case_000", 6.0)
    write_sequence(tmp_path / "set" / "b" / "case_000", 1.5)
    return tmp_path / "set"


def streaks(folder, *options):
    return run(["evaluate", "streaks", str(folder), *options])


def test_sequences_are_read_by_rising_intensity(real):
    light, heavy = find_rain_sequences(real)
    assert (light.name, light.intensity_mm_h, len(light)) == ("b/case_000", 1.5, FRAMES)
    assert heavy.intensity_mm_h == 6.0
    camera = light.camera
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (400, 402, 128.5, 160.5)  # the file has OpenCV's pixels
    np.testing.assert_allclose(camera.position, (0, 0, 1.5))
    np.testing.assert_allclose(camera.world_to_camera[:3, :3] @ [1, 0, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(light.distortion, (-0.4, 0.05, -0.006, 0.007, 0.25))
    np.testing.assert_allclose(light.times_s, 0.1 * np.arange(FRAMES), atol=1e-6)
    assert abs(int(light.gray_image(3)[100, 102]) - 65) < 6
    capture = light.capture([2, 5])
    assert [view.name for view in capture] == ["image_002", "image_005"]
    assert capture[1].time_s == pytest.approx(0.5)
    np.testing.assert_allclose(capture[0].image[150].mean(), 45, atol=1)


def test_streaks_reports_real_and_ours(real, tmp_path, capsys):
    file = tmp_path / "out" / "streaks.json"
    options = ("--exposure", "0.008,0.02", "--frames", "7", "--json", str(file))
    assert streaks(real, *options) == 0
    report = json.loads(file.read_text())
    assert (report["frames"], report["rain_light"], report["seed"]) == (7, "linear", 0)
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
    assert all(row["ours"][0]["streak"]["streaks"] > 0 for row in report["rows"])
    shown = capsys.readouterr().out
    assert shown.count("real") == 2
    assert shown.count("ours") == 4
    again = tmp_path / "again.json"
    assert streaks(real, *options[:-1], str(again)) == 0
    assert again.read_bytes() == file.read_bytes()


def test_options_change_our_rain(real, tmp_path):
    def mean_std(*options):
        file = tmp_path / "numbers.json"
        assert (
            streaks(real / "b", "--exposure", "0.008", "--window", "0,48,256,128", "--json", str(file), *options) == 0
        )
        row = json.loads(file.read_text())["rows"][0]
        assert row["window"] == [0, 48, 256, 128]
        return row["rendered_mm_h"], row["ours"][0]["residual"]["std_levels"]

    (labelled, plain), (none, clear) = mean_std(), mean_std("--rain", "0")
    assert (labelled, none) == (1.5, 0)
    assert plain > clear + 0.05
    assert mean_std("--streak-gain", "4")[1] > plain + 0.05
    assert mean_std("--light", "display")[1] < plain - 0.03
    assert mean_std("--aperture", "8")[1] < plain - 0.03
    assert mean_std("--seed", "1")[1] != plain


@pytest.mark.parametrize(
    ("file", "damage", "words"),
    [
        ("image/image_002.jpg", "no picture", "image_002.jpg"),
        ("timestamps.txt", "timestamps,index\n1.0,0\n", "timestamps.txt: 1 time stamps"),
        ("context/camera_intrinsics.txt", "K_cam:\n1 2 3\n", "camera_intrinsics.txt: 3 numbers"),
        ("context/rainfall_intensity.txt", "current intensity:-3", "-3.0 mm/h"),
    ],
)
def test_a_damaged_sequence_is_named(real, capsys, file, damage, words):
    (real / "a" / "case_000" / file).write_text(damage)
    assert streaks(real / "a") == BAD_INPUT
    assert words in capsys.readouterr().err.splitlines()[-1]
