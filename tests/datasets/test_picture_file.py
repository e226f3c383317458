"""Pictures of data sets: their size without reading them, what is cut, and odd kinds of pixels."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.io.images import image_size, images_in, read_color, read_labels, read_mask

NOISE = np.random.default_rng(3).integers(0, 256, (20, 30, 3), np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pictures")


@pytest.mark.parametrize("suffix", ["png", "jpg", "webp", "bmp", "tif"])
def test_size_and_colour(folder: Path, suffix: str) -> None:
    file = folder / f"whole.{suffix}"
    smooth = np.linspace(0, 255, 30).astype(np.uint8)[None, :, None] + np.zeros((20, 30, 3), np.uint8)
    Image.fromarray(smooth).save(file, quality=95)
    assert image_size(file) == (30, 20)
    np.testing.assert_allclose(read_color(file).astype(float), smooth, atol=8)


@given(suffix=st.sampled_from(["png", "jpg"]), part=st.floats(0, 0.99))
def test_cut_files_are_found_from_their_ends(folder: Path, suffix: str, part: float) -> None:
    file = folder / f"cut.{suffix}"
    Image.fromarray(NOISE).save(file)
    data = file.read_bytes()
    file.write_bytes(data[: int(part * (len(data) - 8))])
    with pytest.raises(CaptureError, match=f"cut.{suffix}: (the picture is cut off|not a readable picture)"):
        image_size(file)
    with pytest.raises(CaptureError, match=f"cut.{suffix}"):
        read_color(file)


def test_a_film_behind_a_picture_is_no_cut(folder: Path) -> None:
    file = folder / "phone.jpg"
    Image.fromarray(NOISE).save(file)
    file.write_bytes(file.read_bytes() + bytes(200_000))
    assert image_size(file) == (30, 20)


def test_grey_of_16_bits_and_palettes(folder: Path) -> None:
    file = folder / "deep.png"
    Image.fromarray(np.array([[0, 257, 65535]], np.uint16)).save(file)
    np.testing.assert_array_equal(read_color(file)[0, :, 0], [0, 1, 255])
    with pytest.raises(CaptureError, match="values outside 0..255"):
        read_labels(file)
    palette = Image.fromarray(np.array([[0, 3, 1]], np.uint8), mode="P")
    palette.putpalette([9] * 768)
    palette.save(folder / "palette.png")
    np.testing.assert_array_equal(read_labels(folder / "palette.png"), [[0, 3, 1]])
    np.testing.assert_array_equal(read_mask(folder / "palette.png"), [[False, True, True]])


def test_only_pictures_are_listed(folder: Path, tmp_path: Path) -> None:
    for name in ("b.PNG", "a.jpg", ".hidden.jpg", "c.txt"):
        (tmp_path / name).touch()
    assert [file.name for file in images_in(tmp_path)] == ["a.jpg", "b.PNG"]
    assert images_in(tmp_path / "nowhere") == []
    with pytest.raises(CaptureError, match="no such picture"):
        image_size(folder / "nowhere.png")


def test_what_is_transparent_lies_over_white(folder: Path) -> None:
    rgba = np.zeros((1, 3, 4), np.uint8)
    rgba[0] = ((250, 0, 90, 0), (100, 0, 0, 255), (0, 0, 0, 51))  # what nobody can look at has a loud color
    Image.fromarray(rgba).save(folder / "clear.png")
    assert read_color(folder / "clear.png")[0].tolist() == [[255, 255, 255], [100, 0, 0], [204, 204, 204]]
    gray = Image.fromarray(np.array([[[0, 0], [80, 255]]], np.uint8), "LA")
    gray.save(folder / "gray.png")
    assert read_color(folder / "gray.png")[0].tolist() == [[255] * 3, [80] * 3]
    palette = Image.fromarray(np.array([[0, 1]], np.uint8), "P")
    palette.putpalette([9, 9, 9, 40, 50, 60])
    palette.save(folder / "palette.png", transparency=0)
    assert read_color(folder / "palette.png")[0].tolist() == [[255] * 3, [40, 50, 60]]
