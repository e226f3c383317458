"""Files that are something else than what they were given as are called what they are, without words of libraries."""

import gzip
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.io.images import image_size, read_color
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import UnknownKindError
from gsrain_engine.safe_io.limits import kind_of_bytes, kind_of_file
from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.scene_files import read_scene

POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n"
ARCHIVE, PICTURE, LFS, VIDEO = "it is an archive", "it is a picture", "it is a pointer of Git LFS", "it is a video"


def zipped(file: Path) -> Path:
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("scene.splat", bytes(64))
    return file


def written(file: Path, data: bytes) -> Path:
    file.write_bytes(data)
    return file


def pictured(file: Path) -> Path:
    Image.fromarray(np.full((20, 30, 3), 90, np.uint8)).save(file)
    return file


FILES = {
    "zip": (lambda folder: zipped(folder / "scene.zip"), ARCHIVE),
    "zip called .ply": (lambda folder: zipped(folder / "scene.ply"), ARCHIVE),
    "pointer": (lambda folder: written(folder / "point_cloud.ply", POINTER), LFS),
    "pointer of a splat": (lambda folder: written(folder / "scene.spz", POINTER), LFS),
    "web page": (lambda folder: written(folder / "a.splat", b"<!DOCTYPE html><html>404</html>"), "it is a web page"),
    "video": (lambda folder: written(folder / "drive.mp4", b"\0\0\0\x18ftypmp42" + bytes(99)), VIDEO),
    "mesh": (lambda folder: written(folder / "car.obj", b"v 0 0 0\n"), "it is a mesh"),
    "picture": (lambda folder: pictured(folder / "a.jpg"), PICTURE),
    "parquet": (lambda folder: written(folder / "a.parquet", b"PAR1" + bytes(50)), "it is a table of a data set"),
}


@pytest.mark.parametrize("name", FILES)
def test_commands_say_what_a_file_is(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    write, told = FILES[name]
    file = write(tmp_path)
    for command in (["info", str(file)], ["render", str(file), "-o", str(tmp_path / "out.png")]):
        assert run(command) == BAD_INPUT
        printed = capsys.readouterr().err
        assert told in printed and file.name in printed and printed.count("\n") == 1


@pytest.mark.parametrize("name", ["zip", "video", "picture"])
def test_transfers_say_what_a_file_is(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    write, told = FILES[name]
    assert run(["transfer", str(write(tmp_path)), "-o", str(tmp_path / "out")]) == BAD_INPUT
    assert told in capsys.readouterr().err


def test_archives_are_no_disdrometers(tmp_path: Path) -> None:
    with pytest.raises(UnknownKindError, match=f"not a disdrometer file; {ARCHIVE}: unpack it") as error:
        read_disdrometer(zipped(tmp_path / "day.txt"))
    assert error.value.kind is not None
    with pytest.raises(UnknownKindError, match=f"not a disdrometer file; {LFS}"):  # in gzip, too, and as text
        read_disdrometer(written(tmp_path / "day.dat.gz", gzip.compress(POINTER)))
    with pytest.raises(UnknownKindError, match="known are OTT Parsivel"):
        read_disdrometer(written(tmp_path / "notes.txt", b"some words\nof a diary\n"))


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (POINTER, "it is a pointer of Git LFS"),
        (b"", "it is an empty file"),
        (bytes(range(200)), "it is of no format that is known"),
        (b"\0\0\0\x18ftypheic" + bytes(300), "it is an HEIC or AVIF picture: convert it"),
    ],
)
def test_broken_pictures_are_named_without_words_of_pillow(tmp_path: Path, data: bytes, told: str) -> None:
    file = written(tmp_path / "a.jpg", data)
    for read in (image_size, read_color):
        with pytest.raises(CaptureError, match=f"a.jpg: not a readable picture: {told}") as error:
            read(file)
        assert "identify" not in str(error.value) and "BytesIO" not in str(error.value)


def test_cut_pictures_are_named_without_words_of_pillow(tmp_path: Path) -> None:
    file = tmp_path / "a.png"
    Image.fromarray(np.random.default_rng(1).integers(0, 256, (64, 64, 3), np.uint8)).save(file)
    written(file, file.read_bytes()[:2000])
    with pytest.raises(CaptureError, match=r"a.png: not a readable picture: it is damaged, or cut off$"):
        read_color(file)


def test_damaged_streams_are_named_without_words_of_libraries(tmp_path: Path) -> None:
    for name, told in (
        ("a.sog", "not a whole zip file: its list of contents"),
        ("b.spz", "the gzip stream is damaged"),
    ):
        file = written(
            tmp_path / name, b"\x1f\x8b\x08\0\0\0\0\0\0\xff" + b"\xff" * 60 if "spz" in name else b"PK\x03\x04abc"
        )
        with pytest.raises(SceneFormatError, match=told) as error:
            read_scene(file)
        assert not any(word in str(error.value) for word in ("Error -3", "not a zip", "decompress"))


def test_what_a_name_says_is_no_surprise_where_readers_go_by_names(tmp_path: Path) -> None:
    file = zipped(tmp_path / "a.sog")
    assert kind_of_file(file) is not None and kind_of_file(file, named_rightly=True) is None
    assert kind_of_file(tmp_path / "none.zip") is None and kind_of_file(tmp_path) is None
    assert kind_of_bytes(b"12;34;56\n", ".txt") is None


def ply(file: Path, properties: str, extra: str = "") -> Path:
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex 1\n{properties}{extra}end_header\n"
    return written(file, head.encode() + bytes(100))


def test_meshes_and_point_clouds_are_called_so(tmp_path: Path) -> None:
    places = "".join(f"property float {axis}\n" for axis in "xyz")
    face = "element face 1\nproperty list uchar int vertex_indices\n"
    for extra, told in (("", "not a PLY of Gaussians but a point cloud"), (face, "not a PLY of Gaussians but a mesh")):
        with pytest.raises(SceneFormatError, match=told):
            read_scene(ply(tmp_path / "a.ply", places, extra))
    with pytest.raises(SceneFormatError, match="not a PLY of Gaussians$"):
        read_scene(ply(tmp_path / "a.ply", places + "property float f_dc_0\n"))
