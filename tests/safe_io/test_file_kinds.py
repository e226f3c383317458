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
from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.safe_io.file_kinds import kind_of_bytes, kind_of_file
from gsrain_engine.scene.formats.scene_files import read_scene

POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n"
ARCHIVE, PICTURE, LFS, VIDEO = "it is an archive", "it is a picture", "it is a pointer of Git LFS", "it is a video"
DAMAGED = "no checkpoint of plain tensors: it is damaged, or none of PyTorch"
CHECKPOINT = "it is a checkpoint of PyTorch: a scene of a training is named .pth, .pt or .ckpt"


def zipped(file: Path, *names: str) -> Path:
    with zipfile.ZipFile(file, "w") as archive:
        for name in names or ("scene.splat",):
            archive.writestr(name, bytes(64))
    return file


def written(file: Path, data: bytes) -> Path:
    file.write_bytes(data)
    return file


def pictured(file: Path) -> Path:
    Image.fromarray(np.full((20, 30, 3), 90, np.uint8)).save(file)
    return file


FILES = {
    "scene.zip": (lambda file: zipped(file, "readme.txt"), "it holds no scene"),
    "scene.ply": (zipped, ARCHIVE),
    "scene.spz": (lambda file: written(file, POINTER), LFS),
    "a.splat": (lambda file: written(file, b"<!DOCTYPE html><html>404</html>"), "it is a web page"),
    "drive.mp4": (lambda file: written(file, b"\0\0\0\x18ftypmp42" + bytes(99)), VIDEO),
    "car.obj": (lambda file: written(file, b"v 0 0 0\n"), "it is a mesh"),
    "a.jpg": (pictured, PICTURE),
    "old.bag": (lambda file: written(file, b"#ROSBAG V2.0\n" + bytes(50)), "it is a bag of ROS 1: rosbags-convert"),
    "metadata.yaml": (lambda file: written(file, b"rosbag2_bagfile_information:\n"), "give its folder"),
    "a.parquet": (lambda file: written(file, b"PAR1" + bytes(50)), "it is a table of a data set"),
    "ckpt_29999_rank0.pt": (lambda file: zipped(file, "ckpt_29999_rank0/data.pkl"), DAMAGED),
    "step-000029999.ckpt": (lambda file: zipped(file, "archive/data.pkl"), DAMAGED),
    "renamed.zip": (lambda file: zipped(file, "archive/data.pkl"), CHECKPOINT),
    "chkpnt30000.pth": (lambda file: written(file, b"\x80\x02}q\0."), "it is a Python pickle"),
    "scene.pth": (lambda file: zipped(file, "archive/data.pkl"), "give its folder"),
    "renamed_sog.zip": (lambda file: zipped(file, "meta.json", "means_l.webp"), "name it .sog"),
    "renamed_spz.gz": (lambda file: written(file, b"NGSP\4\0\0\0" + bytes(24)), "name it .spz"),
    "a.ssproj": (lambda file: zipped(file, "document.json", "splat_0.ply"), "it is a project of SuperSplat"),
    "meta.lcc": (lambda file: written(file, b'{"version": "5.0", "totalSplats": 9, "encoding": "COMPRESS"}'), "LCC"),
    "tileset.json": (lambda file: written(file, b'{"asset": {}, "geometricError": 9, "root": {}}'), "3D Tiles"),
    "dataparser_transforms.json": (lambda file: written(file, b'{"transform": [[1]], "scale": 0.1}'), "ns-export"),
    "cfg_args": (lambda file: written(file, b"Namespace(sh_degree=3, source_path='a')"), "iteration_N"),
    "images.txt": (lambda file: written(file, b"# Image list with two lines of data per image:\n"), "COLMAP"),
    "cameras.bin": (lambda file: written(file, bytes(80)), "COLMAP"),
    "town.xodr": (lambda file: written(file, b"\xef\xbb\xbf<?xml?>\n<OpenDRIVE>"), "it is a map of roads"),
    "cameras.xml": (
        lambda file: written(file, b'<?xml?>\n<document version="1.5.0">\n<chunk>'),
        "ns-process-data metashape",
    ),
    "shots.json": (
        lambda file: written(file, b'[{"cameras": {}, "shots": {}}]'),
        "poses of OpenSfM, which are not read",
    ),
    "cameras.sfm": (lambda file: written(file, b'{"version": ["1"], "views": [{"intrinsicId": "3"}]}'), "exportColmap"),
    "scene.mvs": (lambda file: written(file, b"MVSI\6\0\0\0" + bytes(40)), "InterfaceCOLMAP writes them"),
    "bundle.out": (lambda file: written(file, b"# Bundle file v0.3\n2 9\n"), "poses of Bundler"),
    "scan.nvm": (lambda file: written(file, b"NVM_V3\n\n2\n"), "poses of VisualSFM"),
    "settings.json": (
        lambda file: written(file, b'{"version": 2, "tonemapping": "none", "cameras": []}'),
        "the settings of SuperSplat's viewer",
    ),
    "desk.txt": (lambda file: written(file, b"# a desk\n# timestamp tx ty tz qx qy qz qw\n1 0 0\n"), "of TUM RGB-D"),
    "data.csv": (lambda file: written(file, b"#timestamp, p_RS_R_x [m], p_RS_R_y [m]\n1,2,3\n"), "trajectory of EuRoC"),
    "open3d.json": (lambda file: written(file, b'{"class_name": "PinholeCameraTrajectory"}'), "trajectory of Open3D"),
    "map.json": (lambda file: written(file, b'{"pedestrian_crossings": {"7": {}}}'), "a map of roads of Argoverse 2"),
    "lidar.feather": (lambda file: written(file, b"ARROW1\0\0" + bytes(50)), "it is a table of a data set (Feather)"),
    "beach.hdr": (
        lambda file: written(file, b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n"),
        "it is a picture in linear light",
    ),
    "beach.exr": (lambda file: written(file, b"v/1\1\2\0\0\0" + bytes(50)), "it is a picture in linear light"),
    "bunny.pts": (lambda file: written(file, b"2\n0 0 0\n0 0 1\n"), "it is a mesh or a point cloud"),
    "raw.txt": (lambda file: written(file, b"404: Not Found"), "the download went wrong"),
    "stage.usda": (lambda file: written(file, b"#usda 1.0\n"), "usdzip"),
    "a.safetensors": (lambda file: written(file, bytes(80)), "safetensors"),
}
"""Content, and a part of what a file is called."""

CAMERA_PATH, CAMERA = "gsrain render SCENE --camera-path FILE", "gsrain render SCENE --camera FILE"
USED = {
    "cameras.json": (b'[{"id": 0, "img_name": "a", "rotation": [[1]], "fy": 9.0}]', CAMERA_PATH),
    "renamed_transforms.json": (b'\n {"camera_angle_x": 1.0, "frames": [{"transform_matrix": [[1]]}]}', CAMERA_PATH),
    "nerfstudio.json": (b'{"camera_type": "perspective", "keyframes": [], "camera_path": []}', CAMERA_PATH),
    "own.json": (b'{"version": 1, "keyframes": [{"time_s": 0, "quaternion_wxyz": [1]}]}', CAMERA_PATH),
    "view.json": (b'{"width": 9, "world_to_camera": [[1]]}', CAMERA),
    "yolo.onnx": (b"\x08\x07\x12\x07pytorch", "gsrain evaluate detection --detector FILE"),
    "cut_in.xosc": (b'<?xml version="1.0"?>\n<OpenSCENARIO>', "gsrain drive FILE"),
}
"""Content of files that a command takes, and that command."""


@pytest.mark.parametrize("name", USED)
def test_info_names_the_command_that_takes_a_file(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    data, command = USED[name]
    assert run(["info", str(written(tmp_path / name, data))]) == 0
    printed = capsys.readouterr().out
    assert name in printed and command in " ".join(printed.split())


@pytest.mark.parametrize("name", FILES)
def test_commands_name_the_kind_of_a_file(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    write, kind = FILES[name]
    file, out = write(tmp_path / name), str(tmp_path / "out.png")
    commands = [["info", str(file)], ["render", str(file), "-o", out]]
    if name in ("scene.zip", "drive.mp4", "a.jpg"):
        commands.append(["transfer", str(file), "-o", out])
    for command in commands:
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


@pytest.mark.parametrize("name", ["drive.mcap", "drive.db3", "drive.tfrecord"])
def test_recordings_that_are_pointers_are_named(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(written(tmp_path / name, POINTER))]) == BAD_INPUT
    printed = capsys.readouterr().err
    assert LFS in printed and "magic" not in printed


@pytest.mark.parametrize("name", ["weather.json", "cs700.log", "PW040406.DAT"])
def test_no_suffix_is_proposed_for_a_file_of_another_kind(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in (["info"], ["render", "-o", str(tmp_path / "out.png")]):
        assert run([*command, str(written(tmp_path / name, b'{"days": []}'))]) == BAD_INPUT
        assert "did you mean" not in capsys.readouterr().err


def test_a_kind_that_matches_the_name_is_no_error(tmp_path: Path) -> None:
    file = zipped(tmp_path / "a.sog")
    assert kind_of_file(file) is not None and kind_of_file(file, named_rightly=True) is None
    assert kind_of_file(tmp_path / "none.zip") is None and kind_of_file(tmp_path) is None
    assert kind_of_bytes(b"12;34;56\n", ".txt") is None


@pytest.mark.parametrize(
    ("lines", "kind"),
    [
        ("", "not a PLY of Gaussians but a point cloud$"),
        ("element face 1\nproperty list uchar int vertex_indices\n", "not a PLY of Gaussians but a mesh$"),
        ("property float f_dc_0\n", "not a PLY of Gaussians$"),
    ],
)
def test_meshes_and_point_clouds_are_named(tmp_path: Path, lines: str, kind: str) -> None:
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 1\n"
    places = "".join(f"property float {axis}\n" for axis in "xyz")
    file = written(tmp_path / "a.ply", f"{head}{places}{lines}end_header\n".encode() + bytes(100))
    with pytest.raises(SceneFormatError, match=kind):
        read_scene(file)
