"""SOG: scenes made here in both versions, the real file, and damage to the zip, the numbers and the images."""

import io
import json
import struct
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.sog import read_sog
from gsrain_engine.scene.gaussians import Gaussians

FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
COUNT = 37


def webp(pixels: np.ndarray, **options: Any) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "WEBP", **{"lossless": True, "exact": True, "quality": 0, **options})
    return file.getvalue()


def image(rows: np.ndarray) -> np.ndarray:
    """Pixels of the Gaussians in 8 columns, the last row filled up."""
    pixels = np.zeros((-(-len(rows) // 8) * 8, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(rows), : rows.shape[1]] = rows
    return pixels.reshape(-1, 8, 4)


def scene(bands: int = 2, seed: int = 0) -> tuple[dict[str, Any], dict[str, bytes], dict[str, np.ndarray]]:
    """A meta.json of version 2, its files, and the bytes that are in them."""
    rng = np.random.default_rng(seed)
    names = ("means_l", "means_u", "quats", "scales", "sh0")
    raw = {name: rng.integers(0, 256, (COUNT, 4)).astype(np.uint8) for name in names}
    raw["quats"][:, 3] = 252 + rng.integers(0, 4, COUNT)
    meta: dict[str, Any] = {
        "version": 2,
        "count": COUNT,
        "means": {"mins": [-3, -2, 0.5], "maxs": [3, 1, 0.5], "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": np.linspace(-9, 1, 256).tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": np.linspace(-2, 2, 256).tolist(), "files": ["sh0.webp"]},
    }
    files = {f"{name}.webp": webp(image(rows)) for name, rows in raw.items()}
    if bands:
        coefficients = (0, 3, 8, 15)[bands]
        raw["palette"] = rng.integers(0, 256, (5, 64 * coefficients, 3)).astype(np.uint8)
        raw["labels"] = rng.integers(0, 300, COUNT)
        rest = {"count": 300, "bands": bands, "codebook": np.linspace(-1, 1, 256).tolist()}
        meta["shN"] = {**rest, "files": ["centroids.webp", "labels.webp"]}
        files["centroids.webp"] = webp(raw["palette"])
        files["labels.webp"] = webp(image(np.stack([raw["labels"] % 256, raw["labels"] // 256], axis=1)))
    return meta, files, raw


def zipped(meta: dict[str, Any], files: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr("meta.json", json.dumps(meta))
        for name, data in files.items():
            archive.writestr(name, data)
    return file.getvalue()


def read_bytes(folder: Path, data: bytes) -> Gaussians:
    path = folder / "scene.sog"
    path.write_bytes(data)
    return read_sog(path)


def log_means(raw: dict[str, np.ndarray]) -> np.ndarray:
    part = (raw["means_l"][:, :3] + 256.0 * raw["means_u"][:, :3]) / 65535
    return np.array([-3, -2, 0.5]) + np.array([6, 3, 0]) * part


@pytest.mark.parametrize("bands", range(4))
def test_version_2(bands: int, tmp_path: Path) -> None:
    meta, files, raw = scene(bands)
    g = read_bytes(tmp_path, zipped(meta, files, zipfile.ZIP_DEFLATED))
    means = np.sign(log_means(raw)) * (np.exp(np.abs(log_means(raw))) - 1)
    np.testing.assert_allclose(g.means, means, atol=1e-5)
    np.testing.assert_allclose(np.log(g.scales), -9 + 10 * (raw["scales"][:, :3] / 255), atol=1e-5)
    np.testing.assert_allclose(g.opacities, raw["sh0"][:, 3] / 255, atol=1e-6)
    np.testing.assert_allclose(g.sh[:, 0], -2 + 4 * (raw["sh0"][:, :3] / 255), atol=1e-5)
    assert g.sh_degree == bands
    for i in range(COUNT if bands else 0):
        row, column = divmod(int(raw["labels"][i]), 64)
        k = g.sh.shape[1] - 1
        entry = raw["palette"][row, column * k : (column + 1) * k]
        np.testing.assert_allclose(g.sh[i, 1:], -1 + 2 * (entry / 255), atol=1e-5)
    for q, pixel in zip(g.quaternions, raw["quats"], strict=True):
        others = np.delete(q, pixel[3] - 252)
        stored = (pixel[:3] / 127.5 - 1) / np.sqrt(2)
        np.testing.assert_allclose(others, stored / max(1, np.linalg.norm(stored)), atol=1e-5)
        assert q[pixel[3] - 252] >= 0


def test_version_1(tmp_path: Path) -> None:
    meta, files, raw = scene(1)
    ranges = {"mins": [-9, -8, -7], "maxs": [1, 0, 2]}
    old = {
        "means": {**meta["means"], "shape": [COUNT, 3], "dtype": "float32"},
        "scales": {**ranges, "files": ["scales.webp"]},
        "quats": meta["quats"],
        "sh0": {"mins": [-1, -2, -3, -6], "maxs": [1, 2, 3, 4], "files": ["sh0.webp"]},
        "shN": {"mins": -0.5, "maxs": 1.5, "files": meta["shN"]["files"]},
    }
    g = read_bytes(tmp_path, zipped(old, files))
    new = read_bytes(tmp_path, zipped(meta, files))
    np.testing.assert_array_equal(g.means, new.means)
    np.testing.assert_array_equal(g.quaternions, new.quaternions)
    expected = np.array([-9, -8, -7]) + np.array([10, 8, 9]) * (raw["scales"][:, :3] / 255)
    np.testing.assert_allclose(np.log(g.scales), expected, atol=1e-5)
    np.testing.assert_allclose(g.sh[:, 0], np.array([1, 2, 3]) * (raw["sh0"][:, :3] / 127.5 - 1), atol=1e-5)
    np.testing.assert_allclose(np.log(g.opacities / (1 - g.opacities)), -6 + 10 * (raw["sh0"][:, 3] / 255), atol=1e-3)
    np.testing.assert_allclose(g.sh[:, 1:], new.sh[:, 1:] + 0.5, atol=1e-5)


def test_loose_files(tmp_path: Path) -> None:
    meta, files, _ = scene()
    for name, data in {**files, "meta.json": json.dumps(meta).encode()}.items():
        (tmp_path / name).write_bytes(data)
    by_folder, by_meta = read_sog(tmp_path), read_sog(tmp_path / "meta.json")
    by_zip = read_bytes(tmp_path, zipped(meta, files))
    for g in (by_folder, by_meta):
        assert (g.means == by_zip.means).all()
        assert (g.sh == by_zip.sh).all()
    (tmp_path / "quats.webp").unlink()
    with pytest.raises(SceneFormatError, match=r"no file quats\.webp"):
        read_sog(tmp_path)


def test_codebook_that_starts_with_null(tmp_path: Path) -> None:
    meta, files, raw = scene(0)
    raw["sh0"][0, :3] = 0
    files["sh0.webp"] = webp(image(raw["sh0"]))
    meta["sh0"]["codebook"][0] = None
    g = read_bytes(tmp_path, zipped(meta, files))
    step = 4 / 255
    np.testing.assert_allclose(g.sh[0, 0], -2 + step - (4 - step) / 255, atol=1e-5)


def changed(path: str, value: Any) -> bytes:
    meta, files, _ = scene()
    *parents, last = path.split(".")
    place = meta
    for name in parents:
        place = place[name]
    place[last] = value
    return zipped(meta, files)


def with_file(name: str, data: bytes) -> bytes:
    meta, files, _ = scene()
    return zipped(meta, {**files, name: data})


def without_file(name: str) -> bytes:
    meta, files, _ = scene()
    return zipped(meta, {key: data for key, data in files.items() if key != name})


GOOD = np.zeros((5, 8, 4), np.uint8)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "zip"),
        (without_file("sh0.webp"), r"no sh0\.webp"),
        (changed("version", 3), "version 3"),
        (changed("count", "many"), r"\$\.count"),
        (changed("count", -1), r"\$\.count"),
        (changed("count", 38 * 10**8), "can't be in a file"),
        (changed("count", 41), "8 x 5 pixels"),
        (changed("means.mins", [0, 0]), r"\$\.means\.mins"),
        (changed("means.maxs", [1e30, 1, 1]), "mean that is not a finite"),
        (changed("means.files", ["../means_l.webp", "means_u.webp"]), "without a folder"),
        (changed("means.files", ["means_l.webp", "/etc/passwd"]), "without a folder"),
        (changed("means.files", ["C:\\x.webp", "means_u.webp"]), "without a folder"),
        (changed("quats.files", [".."]), "not the name"),
        (changed("scales.codebook", [0.0] * 257), r"\$\.scales\.codebook"),
        (changed("scales.codebook", [1e4] * 256), "scale that is not a finite"),
        (changed("sh0.codebook", [0.0, 1.0]), "color that is not a finite"),
        (changed("sh0.codebook", [0.0, None]), "null"),
        (changed("shN.bands", 4), "bands"),
        (changed("shN.bands", 3), "960"),
        (changed("shN.count", 1000), "320 entries"),
        (changed("shN.count", 20), "the last one is 19"),
        (with_file("quats.webp", webp(GOOD)), "alpha below 252"),
        (with_file("quats.webp", b"not an image"), "not a WebP"),
        (with_file("quats.webp", bytes(10**6)), "has 1000000 bytes, at most"),
        (with_file("quats.webp", webp(GOOD, lossless=False, quality=80)), "lossless"),
        (with_file("sh0.webp", webp(np.zeros((600, 600, 4), np.uint8))), "600 x 600"),
        (with_file("sh0.webp", scene()[1]["sh0.webp"][:-20]), "damaged"),
    ],
)
def test_what_is_wrong_is_said(data: bytes, words: str, tmp_path: Path) -> None:
    with pytest.raises(SceneFormatError, match=words):
        read_bytes(tmp_path, data)


@pytest.mark.parametrize("text", [b"[" * 100_000, b"\xff\xfe", b"nonsense", b"[]", b'{"version": "2"}', b"{}"])
def test_meta_that_is_no_description(text: bytes, tmp_path: Path) -> None:
    (tmp_path / "meta.json").write_bytes(text)
    with pytest.raises(SceneFormatError, match=r"meta\.json"):
        read_sog(tmp_path)


def test_a_canvas_larger_than_its_image_is_refused_undecoded(tmp_path: Path) -> None:
    # libwebp would allocate 16384 x 16384 pixels for it: memory that tracemalloc does not see.
    canvas = b"VP8X" + struct.pack("<I", 10) + b"\x10\0\0\0" + b"\xff\x3f\0" * 2
    bomb = b"RIFF" + struct.pack("<I", 4 + len(canvas) + len(webp(GOOD)) - 12) + b"WEBP" + canvas + webp(GOOD)[12:]
    with pytest.raises(SceneFormatError, match=r"header says \(16384, 16384\) pixels"):
        read_bytes(tmp_path, with_file("quats.webp", bomb))


def test_members_with_a_password_are_refused(tmp_path: Path) -> None:
    data = bytearray(zipped(*scene()[:2]))
    data[data.index(b"PK\x01\x02") + 8] |= 1  # in the directory of the archive
    with pytest.raises(SceneFormatError, match="must be stored or deflated, without a password"):
        read_bytes(tmp_path, bytes(data))


def test_bombs_take_no_memory(tmp_path: Path) -> None:
    meta, files, _ = scene()
    bombs = [
        zipped(meta, {**files, "quats.webp": webp(np.zeros((3000, 3000, 4), np.uint8))}),
        zipped(meta, {**files, "quats.webp": bytes(60_000_000)}, zipfile.ZIP_DEFLATED),
        zipped({**meta, "padding": "x" * 60_000_000}, files, zipfile.ZIP_DEFLATED),
    ]
    tracemalloc.start()
    try:
        for bomb in bombs:
            with pytest.raises(SceneFormatError):
                read_bytes(tmp_path, bomb)
        assert tracemalloc.get_traced_memory()[1] < 30e6
    finally:
        tracemalloc.stop()


def test_cut_off_is_refused(tmp_path: Path) -> None:
    data = zipped(*scene()[:2])
    for end in [*range(0, len(data), 41), len(data) - 1]:
        with pytest.raises(SceneFormatError):
            read_bytes(tmp_path, data[:end])


def test_real_file(test_data: Path) -> None:
    g = read_sog(test_data / "scenes/playbot/playbot_lod3_31k_sh2.sog")
    assert (len(g), g.sh_degree) == (31_000, 2)


def read_or_refuse(folder: Path, data: bytes) -> None:
    try:
        g = read_bytes(folder, data)
    except SceneFormatError as error:
        assert error.path == folder / "scene.sog"
    else:
        assert all(np.isfinite(a).all() for a in (g.means, g.scales, g.opacities, g.sh))
        np.testing.assert_allclose(np.linalg.norm(g.quaternions, axis=1), 1, atol=1e-5)


@given(data=st.data())
@FUZZ
def test_a_damaged_zip_is_read_or_refused(data: st.DataObject, tmp_path: Path) -> None:
    raw = bytearray(zipped(*scene(1)[:2], zipfile.ZIP_DEFLATED))
    for _ in range(data.draw(st.integers(1, 4))):
        # Half of the hits on the directory at the end, which is what steers the reading.
        low = data.draw(st.sampled_from([0, len(raw) - 600]))
        raw[data.draw(st.integers(low, len(raw) - 1))] = data.draw(st.integers(0, 255))
    read_or_refuse(tmp_path, bytes(raw))


@given(data=st.data())
@FUZZ
def test_damaged_images_are_read_or_refused(data: st.DataObject, tmp_path: Path) -> None:
    # The zip's checksums are right here, so that the damage reaches the decoder.
    meta, files, _ = scene(1)
    name = data.draw(st.sampled_from(sorted(files)))
    raw = bytearray(files[name])
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    read_or_refuse(tmp_path, zipped(meta, {**files, name: bytes(raw)}))


json_values = st.none() | st.integers() | st.floats() | st.text(max_size=5) | st.lists(st.floats(), max_size=4)


paths = ["version", "count", "means", "scales.codebook", "sh0.files", "shN.bands", "shN", "means.mins"]


@given(path=st.sampled_from(paths), value=json_values)
@FUZZ
def test_any_number_in_the_meta_is_read_or_refused(path: str, value: Any, tmp_path: Path) -> None:
    read_or_refuse(tmp_path, changed(path, value))
