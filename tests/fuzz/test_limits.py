"""Small files that ask for much: bombs, lying headers and paths out of their folder end before memory is taken."""

import gzip
import io
import json
import os
import pickle
import stat
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from PIL import Image

from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.io.arrays import read_floats, read_json, read_npz
from gsrain_engine.datasets.io.images import image_size, read_color, read_stored
from gsrain_engine.datasets.io.safe_pickle import read_pickle
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.camera_path_io import read_camera_path
from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.scene_files import read_scene
from tests.scene.formats.test_sog import scene as sog_scene
from tests.scene.formats.test_sog import webp

from .capture_readers import CAPTURE_READERS
from .reader import limited_memory, limited_time


def _refused(path: Path, words: str) -> None:
    with limited_memory(), limited_time(5), pytest.raises((SceneFormatError, CaptureError), match=words):
        read_scene(path)


def _spz(count: int, version: int = 3) -> bytes:
    return struct.pack("<4sII4B", b"NGSP", version, count, 0, 12, 0, 0)


def test_spz_bombs(tmp_path: Path) -> None:
    path = tmp_path / "a.spz"
    path.write_bytes(gzip.compress(_spz(2**32 - 1)))
    _refused(path, r"a\.spz: the header speaks of 4294967295 Gaussians")
    path.write_bytes(gzip.compress(_spz(7) + bytes(1 << 24)))
    _refused(path, r"a\.spz: the gzip stream holds more than")
    frames = [zstandard.compress(bytes(1 << 24))] * 5
    table = b"".join(struct.pack("<QQ", len(frame), 9) for frame in frames)
    path.write_bytes(struct.pack("<4sII4BI12x", b"NGSP", 4, 1, 0, 12, 0, 5, 32) + table + b"".join(frames))
    _refused(path, r"a\.spz: the zstd stream of means must hold 9 bytes, it holds more")


def test_as_many_equal_gaussians_as_a_small_file_may_hold_take_little_memory(tmp_path: Path) -> None:
    count = 1_000_000
    path = tmp_path / "a.spz"
    path.write_bytes(gzip.compress(_spz(count) + bytes(20 * count)))
    assert path.stat().st_size < 30_000
    with limited_memory():
        assert len(read_scene(path).layers[0].gaussians) == count


def _sog(folder: Path, meta: dict[str, Any], files: list[tuple[zipfile.ZipInfo | str, bytes]]) -> Path:
    path = folder / "a.sog"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("meta.json", json.dumps(meta))
        for name, data in files:
            archive.writestr(name, data)
    return path


def test_sog_bombs(tmp_path: Path) -> None:
    meta, files, _ = sog_scene(0)
    rest = [(name, data) for name, data in files.items() if name != "means_l.webp"]
    huge = webp(np.zeros((4096, 4096, 4), np.uint8))
    _refused(_sog(tmp_path, meta, [("means_l.webp", huge), *rest]), r"means_l\.webp has 4096 x 4096 pixels, not one")
    _refused(
        _sog(tmp_path, meta, [("means_l.webp", bytes(1 << 24)), *rest]), r"means_l\.webp has 16777216 bytes, at most"
    )
    _refused(_sog(tmp_path, {**meta, "count": 2**32 - 1}, rest), "speaks of 4294967295 Gaussians")
    _refused(_sog(tmp_path, {**meta, "asset": "x" * (1 << 21)}, rest), r"meta\.json has \d+ bytes, at most 1048576")


@pytest.mark.parametrize("name", ["../means_l.webp", "/etc/means_l.webp", "a/means_l.webp", "..\\means_l.webp", ".."])
def test_sog_files_lie_beside_their_description(name: str, tmp_path: Path) -> None:
    meta, files, _ = sog_scene(0)
    outside = tmp_path / "means_l.webp"
    outside.write_bytes(files["means_l.webp"])
    meta["means"]["files"][0] = name
    _refused(_sog(tmp_path, meta, [(name, files["means_l.webp"]), *files.items()]), "meta.json: ")
    folder = tmp_path / "scene"
    folder.mkdir()
    (folder / "meta.json").write_text(json.dumps(meta))
    for each, data in files.items():
        (folder / each).write_bytes(data)
    _refused(folder, "meta.json: ")


def test_sog_entries_that_are_links_or_come_twice_reach_nothing_outside(tmp_path: Path) -> None:
    meta, files, _ = sog_scene(0)
    link = zipfile.ZipInfo("means_l.webp")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    rest = [(name, data) for name, data in files.items() if name != "means_l.webp"]
    _refused(_sog(tmp_path, meta, [(link, b"/etc/passwd"), *rest]), r"means_l\.webp is not a WebP image")
    with pytest.warns(UserWarning, match="Duplicate name"):
        path = _sog(tmp_path, meta, [("means_l.webp", b"first"), *files.items()])
    assert len(read_scene(path).layers[0].gaussians) == 37  # the last one counts


def _png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    )


def _jpeg(width: int, height: int) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (8, 8)).save(file, "JPEG")
    data = bytearray(file.getvalue())
    place = data.index(b"\xff\xc0") + 5
    data[place : place + 4] = struct.pack(">HH", height, width)
    return bytes(data)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.png", _png(9000, 9000), "says that it holds 324 MB, which can't be in"),
        ("a.png", _png(16000, 16000), "not a readable picture"),
        ("a.png", _png(60000, 10), "at most 16384 a side"),
        ("a.jpg", _jpeg(9000, 9000), "says that it holds 324 MB"),
        ("a.jpg", _jpeg(65500, 65500), "not a readable picture"),
    ],
    ids=("png", "larger png", "long png", "jpeg", "largest jpeg"),
)
def test_picture_bombs(name: str, content: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    for read in (image_size, read_color, read_stored):
        with limited_memory(), pytest.raises(CaptureError, match=rf"{name}: .*({words})"):
            read(path)


def test_pictures_of_one_colour_are_no_bombs(tmp_path: Path) -> None:
    for name in ("a.png", "a.jpg"):
        Image.new("RGB", (5000, 4000), (9, 9, 9)).save(tmp_path / name)
        assert image_size(tmp_path / name) == (5000, 4000)
    Image.new("1", (8000, 6000)).save(tmp_path / "mask.png")
    assert image_size(tmp_path / "mask.png") == (8000, 6000)


def _npy(shape: str, descr: str = "<f4", rows: bytes = b"") -> bytes:
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + rows


@pytest.mark.parametrize(
    "shape", ["(1000000, 1000000)", "(-1, -4)", "(9" + "9" * 40 + ",)", "(" * 90 + "1" + ",)" * 90]
)
def test_arrays_that_lie_about_their_size(shape: str, tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(_npy(shape))
    with limited_memory(), pytest.raises(CaptureError, match=r"a\.npy: not a readable \.npy file"):
        read_floats(tmp_path / "a.npy")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("data.npy", _npy(shape))
    with limited_memory(), pytest.raises(CaptureError, match=r"a\.npz: not a readable \.npz file"):
        read_npz(tmp_path / "a.npz", "data")


@pytest.mark.parametrize(
    "content",
    [
        b"\x80\x02K\x01r\xff\xff\xff\xff.",  # a place in the memo far beyond those before: 64 GB in Python's own reader
        b"I1\np4000000000\n.",
        b"\x80\x05\x96" + struct.pack("<Q", 1 << 40) + b"a.",
        b"\x80\x04\x8e" + struct.pack("<Q", 1 << 63) + b"a.",
        b"\x80\x02T\xff\xff\xff\xffa.",
        b"\x80\x02]q\x00",
    ],
)
def test_pickles_that_ask_for_more_than_there_is(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.pkl").write_bytes(content)
    with limited_memory(), pytest.raises(CaptureError, match=r"a\.pkl: not a readable pickle \(damaged or cut off"):
        read_pickle(tmp_path / "a.pkl")


def test_whole_pickles_are_read(tmp_path: Path) -> None:
    values = {"a": list(range(3000)), "b": "x" * 70_000, "c": b"9" * 300, "d": np.arange(1e4), "e": 10**400}
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        (tmp_path / "a.pkl").write_bytes(pickle.dumps(values, protocol))
        found = read_pickle(tmp_path / "a.pkl")
        assert all(np.array_equal(found[name], value) for name, value in values.items())


def test_endless_json_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "path.json"
    with path.open("wb") as file:
        file.truncate(2 << 30)  # a hole: nothing on the disk
    with limited_memory(), pytest.raises(SceneFormatError, match=r"path\.json: can't be read: larger than 268 MB"):
        read_camera_path(path)
    with limited_memory(), pytest.raises(CaptureError, match=r"path\.json: larger than 1074 MB"):
        read_json(path)


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    (reader,) = (each for each in CAPTURE_READERS if each.name == "nerfstudio")
    folder = reader.write(tmp_path)
    for name in ("depth.npy", "images/a.png", "images/b.png"):
        (folder / name).unlink()
        os.mkfifo(folder / name)
    with limited_time(5):
        capture = open_capture(folder)
        assert [view.name for view in capture] == ["c"]
    (tmp_path / "endless.json").symlink_to("/dev/zero")
    with limited_memory(), limited_time(5), pytest.raises(CaptureError, match="endless.json: not a file"):
        read_json(tmp_path / "endless.json")
