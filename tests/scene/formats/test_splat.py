""".splat files."""

from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.ksplat import read_splat, write_splat
from gsrain_engine.scene.gaussians import SH_C0, Gaussians

from .sample_gaussians import sample_gaussians


def test_round_trip_within_8_bits(tmp_path: Path) -> None:
    gaussians = sample_gaussians(sh_degree=2)
    write_splat(gaussians, tmp_path / "a.splat")
    read = read_splat(tmp_path / "a.splat")
    np.testing.assert_array_equal(read.means, gaussians.means)
    np.testing.assert_array_equal(read.scales, gaussians.scales)
    np.testing.assert_allclose(read.opacities, gaussians.opacities, atol=0.5 / 255 + 1e-6)
    assert (1 - (read.quaternions * gaussians.quaternions).sum(1)).max() < 1e-4
    colors = np.clip(gaussians.sh[:, 0] * SH_C0 + 0.5, 0, 1)
    np.testing.assert_allclose(read.sh[:, 0] * SH_C0 + 0.5, colors, atol=0.5 / 255 + 1e-6)
    assert read.sh_degree == 0


def test_what_was_read_is_written_to_the_same_numbers(tmp_path: Path) -> None:
    write_splat(sample_gaussians(), tmp_path / "a.splat")
    write_splat(read_splat(tmp_path / "a.splat"), tmp_path / "b.splat")
    a, b = (np.frombuffer((tmp_path / name).read_bytes(), np.uint8).reshape(-1, 32) for name in ("a.splat", "b.splat"))
    np.testing.assert_array_equal(a[:, :28], b[:, :28])
    assert np.abs(a[:, 28:].astype(int) - b[:, 28:]).max() <= 1


def test_colours_beyond_white_are_cut(tmp_path: Path) -> None:
    one = sample_gaussians(1, 0)
    bright = Gaussians(one.means, one.scales, one.quaternions, one.opacities, np.array([[[9, -9, 0]]], np.float32))
    write_splat(bright, tmp_path / "a.splat")
    assert list((tmp_path / "a.splat").read_bytes()[24:27]) == [255, 0, 128]


def test_a_phone_capture(test_data: Path) -> None:
    gaussians = read_splat(test_data / "scenes/plant.splat")
    assert len(gaussians) == 113_648
    np.testing.assert_allclose(np.ptp(gaussians.means, axis=0), [0.5172, 1.0, 0.6098], atol=2e-4)  # plant.meta.json


def test_the_smallest_file(test_data: Path) -> None:
    gaussians = read_splat(test_data / "scenes/minimal/minimal.splat")
    np.testing.assert_array_equal(gaussians.means, [[-1, 0, -1], [0, 0, -1], [-1, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(gaussians.quaternions, [[0, 0, 0, 1]] * 4)


@pytest.mark.parametrize("size", [0, 1, 31, 33, 127])
def test_sizes_that_are_no_whole_rows_are_refused(size: int, tmp_path: Path) -> None:
    (tmp_path / "a.splat").write_bytes(bytes(size))
    with pytest.raises(SceneFormatError, match=f"32 bytes a Gaussian; {size} bytes are no whole number"):
        read_splat(tmp_path / "a.splat")


def test_values_that_no_gaussian_has_are_refused(tmp_path: Path) -> None:
    write_splat(sample_gaussians(5), tmp_path / "a.splat")
    rows = np.frombuffer((tmp_path / "a.splat").read_bytes(), np.uint8).reshape(5, 32)
    negative = np.array([-0.5], "<f4").view(np.uint8)
    nan = np.array([np.nan], "<f4").view(np.uint8)
    for columns, bad, message in [
        (slice(28, 32), 128, "a zero quaternion"),
        (slice(12, 16), negative, "a negative scale"),
        (slice(4, 8), nan, "a mean that is not a finite number"),
        (slice(20, 24), nan, "a scale that is not a finite number"),
    ]:
        edited = rows.copy()
        edited[3, columns] = bad
        (tmp_path / "b.splat").write_bytes(edited.tobytes())
        with pytest.raises(SceneFormatError, match=f"1 of 5 Gaussians have {message}, the first is number 3"):
            read_splat(tmp_path / "b.splat")
