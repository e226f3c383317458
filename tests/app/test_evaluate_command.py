"""`gsrain evaluate streaks` on a small made-up data set in RainSense's layout."""

import numpy as np
import pytest
from PIL import Image

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
    command = ("evaluate", "streaks", real, "--exposure", "0.008,0.02", "--frames", "7")
    report = reported(*command)
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
        assert row["ours"][0]["streak"]["streaks"] > 0
    printed = capsys.readouterr().out
    assert (printed.count("real"), printed.count("ours")) == (2, 4)
    assert reported(*command) == report


def test_options_change_the_rendered_rain(real, reported):
    def mean_std(*options):
        (row,) = reported(
            "evaluate", "streaks", real / "b", "--exposure", "0.008", "--window", "0,48,256,128", *options
        )["rows"]
        assert row["window"] == [0, 48, 256, 128]
        return row["rendered_mm_h"], row["ours"][0]["residual"]["std_levels"]

    (labelled, plain), (none, clear) = mean_std(), mean_std("--rain", "0")
    assert (labelled, none) == (1.5, 0)
    assert plain > clear + 0.05
    assert mean_std("--streak-gain", "4")[1] > plain + 0.05
    assert mean_std("--light", "display")[1] < plain - 0.03
    assert mean_std("--aperture", "8")[1] < plain - 0.03
    assert mean_std("--seed", "1")[1] != plain
