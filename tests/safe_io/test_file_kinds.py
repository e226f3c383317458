"""Files that are something else than what they were given as are called what they are, without words of libraries."""

import gzip
import io
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
def test_commands_name_what_a_file_is(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    write, kind = FILES[name]
    file, out = write(tmp_path), str(tmp_path / "out.png")
    commands = [["info", str(file)], ["render", str(file), "-o", out], ["transfer", str(file), "-o", out]]
    for command in commands if name in ("zip", "video", "picture") else commands[:2]:
        assert run(command) == BAD_INPUT
        printed = capsys.readouterr().err
        assert kind in printed and printed.count("\n") == 1
        assert file.name in printed or command[0] == "transfer"


def test_archives_are_no_disdrometers(tmp_path: Path) -> None:
    with pytest.raises(UnknownKindError, match=f"not a disdrometer file; {ARCHIVE}: unpack it") as error:
        read_disdrometer(zipped(tmp_path / "day.txt"))
    assert error.value.kind is not None
    with pytest.raises(UnknownKindError, match=f"not a disdrometer file; {LFS}"):  # in gzip, too, and as text
        read_disdrometer(written(tmp_path / "day.dat.gz", gzip.compress(POINTER)))
    with pytest.raises(UnknownKindError, match="known are OTT Parsivel"):
        read_disdrometer(written(tmp_path / "notes.txt", b"some words\nof a diary\n"))


def cut_png() -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.random.default_rng(1).integers(0, 256, (64, 64, 3), np.uint8)).save(file, "PNG")
    return file.getvalue()[:2000]


@pytest.mark.parametrize(
    ("name", "data", "problem"),
    [
        ("a.jpg", POINTER, "not a readable picture: it is a pointer of Git LFS"),
        ("a.jpg", b"", "not a readable picture: it is an empty file"),
        ("a.jpg", bytes(range(200)), "not a readable picture: it is of no format that is known"),
        ("a.jpg", b"\0\0\0\x18ftypheic" + bytes(300), "it is an HEIC or AVIF picture: convert it"),
        ("a.png", cut_png(), "not a readable picture: it is damaged, or cut off"),
        ("a.sog", b"PK\x03\x04abc", "not a whole zip file"),
        ("a.spz", b"\x1f\x8b\x08\0\0\0\0\0\0\xff" + b"\xff" * 60, "the gzip stream is damaged"),
    ],
)
def test_damage_is_named_without_words_of_libraries(tmp_path: Path, name: str, data: bytes, problem: str) -> None:
    file = written(tmp_path / name, data)
    for read in (read_color, image_size) if name == "a.jpg" else (read_color if name == "a.png" else read_scene,):
        with pytest.raises((CaptureError, SceneFormatError), match=f"{name}: .*{problem}") as error:
            read(file)
        words = ("identify", "BytesIO", "Error -3", "not a zip file", "decompress")
        assert not any(word in str(error.value) for word in words)


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
