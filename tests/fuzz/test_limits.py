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
from collections.abc import Callable
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from PIL import Image

from app.main import run
from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.io.arrays import read_floats, read_json, read_npz
from gsrain_engine.datasets.io.images import image_size, read_color, read_stored
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.disdrometer import hdf5_trial
from gsrain_engine.disdrometer.hdf5_trial import passes_trial
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError
from gsrain_engine.evaluation.detection.detector import open_detector
from gsrain_engine.evaluation.lpips_weights import read_arrays
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.safe_io.numpy_files import read_archive
from gsrain_engine.safe_io.text_files import check_finite, json_values, yaml_values
from gsrain_engine.scene.camera_path_io import read_camera_path
from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.simulation.agents.http import ClientError
from gsrain_engine.simulation.interop.hugsim_protocol import read_reply
from gsrain_engine.simulation.rollout_io import read_any_rollout, read_rollout_parquet
from gsrain_engine.simulation.scenario_io import load_scenario
from tests.evaluation.detection.tiny_onnx import NAMES, rows, write_constant
from tests.scene.formats.sample_files import SOG_COUNT, sog_scene, spz_header, webp

from .capture_readers import CAPTURE_READERS
from .reader import limited_memory, limited_time

# Scenes


def refused(path: Path, words: str) -> None:
    with limited_memory(), limited_time(5), pytest.raises(SceneFormatError, match=words):
        read_scene(path)


def zstd_bomb() -> bytes:
    frames = [zstandard.compress(bytes(1 << 24))] * 5
    table = b"".join(struct.pack("<QQ", len(frame), 9) for frame in frames)
    return spz_header(4, 1, streams=5) + struct.pack("<I12x", 32) + table + b"".join(frames)


def sog(meta: dict[str, Any], files: list[tuple[zipfile.ZipInfo | str, bytes]]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("meta.json", json.dumps(meta))
        for name, data in files:
            archive.writestr(name, data)
    return file.getvalue()


def sog_with(means_l: bytes = b"", **fields: Any) -> bytes:
    meta, files, _ = sog_scene(0)
    return sog(meta | fields, list((files | {"means_l.webp": means_l}).items()))


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("a.spz", lambda: gzip.compress(spz_header(3, 2**32 - 1)), "4294967295 Gaussians"),
        ("a.spz", lambda: spz_header(4, 2**32 - 1, streams=5) + bytes(100), "4294967295 Gaussians"),
        ("a.spz", lambda: gzip.compress(spz_header(3, 7) + bytes(1 << 24)), "the gzip stream holds more than"),
        ("a.spz", zstd_bomb, "the zstd stream of means must hold 9 bytes, it holds more"),
        ("a.sog", lambda: sog_with(webp(np.zeros((4096, 4096, 4), np.uint8))), r"means_l\.webp has 4096 x 4096"),
        ("a.sog", lambda: sog_with(bytes(1 << 24)), r"means_l\.webp has 16777216 bytes, at most"),
        ("a.sog", lambda: sog_with(count=2**32 - 1), "4294967295 Gaussians"),
        ("a.sog", lambda: sog_with(asset="x" * (1 << 21)), r"meta\.json has \d+ bytes, at most 1048576"),
    ],
)  # fmt: skip
def test_bombs_take_no_memory(file: str, content: Callable[[], bytes], words: str, tmp_path: Path) -> None:
    (tmp_path / file).write_bytes(content())
    refused(tmp_path / file, rf"{file}: .*{words}")


def test_as_many_equal_gaussians_as_a_small_file_may_hold_take_little_memory(tmp_path: Path) -> None:
    count = 1_000_000
    path = tmp_path / "a.spz"
    path.write_bytes(gzip.compress(spz_header(3, count) + bytes(20 * count)))
    assert path.stat().st_size < 30_000
    with limited_memory():
        assert len(read_scene(path).layers[0].gaussians) == count


@pytest.mark.parametrize("name", ["../means_l.webp", "/etc/means_l.webp", "a/means_l.webp", "..\\means_l.webp", ".."])
def test_sog_files_lie_in_the_folder_of_their_description(name: str, tmp_path: Path) -> None:
    meta, files, _ = sog_scene(0)
    (tmp_path / "means_l.webp").write_bytes(files["means_l.webp"])
    meta["means"]["files"][0] = name
    (tmp_path / "a.sog").write_bytes(sog(meta, [(name, files["means_l.webp"]), *files.items()]))
    refused(tmp_path / "a.sog", "meta.json: ")
    folder = tmp_path / "scene"
    folder.mkdir()
    (folder / "meta.json").write_text(json.dumps(meta))
    for each, data in files.items():
        (folder / each).write_bytes(data)
    refused(folder, "meta.json: ")


def test_sog_entries_that_are_links_or_come_twice_reach_nothing_outside(tmp_path: Path) -> None:
    meta, files, _ = sog_scene(0)
    link = zipfile.ZipInfo("means_l.webp")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    rest = [(name, data) for name, data in files.items() if name != "means_l.webp"]
    (tmp_path / "a.sog").write_bytes(sog(meta, [(link, b"/etc/passwd"), *rest]))
    refused(tmp_path / "a.sog", r"means_l\.webp is not a WebP image")
    with pytest.warns(UserWarning, match="Duplicate name"):
        (tmp_path / "a.sog").write_bytes(sog(meta, [("means_l.webp", b"first"), *files.items()]))
    assert len(read_scene(tmp_path / "a.sog").layers[0].gaussians) == SOG_COUNT  # the last one counts


# Pictures and arrays


def png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = chunk(b"IHDR", head), chunk(b"IDAT", zlib.compress(bytes(1000))), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def jpeg(width: int, height: int) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (8, 8)).save(file, "JPEG")
    data = bytearray(file.getvalue())
    place = data.index(b"\xff\xc0") + 5
    data[place : place + 4] = struct.pack(">HH", height, width)
    return bytes(data)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.png", png(9000, 9000), "324 MB"),
        ("a.png", png(16000, 16000), "not a readable picture"),
        ("a.png", png(60000, 10), "at most 16384 a side"),
        ("a.jpg", jpeg(9000, 9000), "324 MB"),
        ("a.jpg", jpeg(65500, 65500), "not a readable picture"),
    ],
    ids=("png", "larger png", "long png", "jpeg", "largest jpeg"),
)
def test_picture_bombs(name: str, content: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    for read in (image_size, read_color, read_stored):
        with limited_memory(), pytest.raises(CaptureError, match=rf"{name}: .*({words})"):
            read(path)


def test_pictures_of_one_color_are_no_bombs(tmp_path: Path) -> None:
    for name, mode, size in (
        ("a.png", "RGB", (5000, 4000)),
        ("a.jpg", "RGB", (5000, 4000)),
        ("m.png", "1", (8000, 6000)),
    ):
        Image.new(mode, size).save(tmp_path / name)
        assert image_size(tmp_path / name) == size


def array_header(shape: str, kind: str = "'<f4'") -> bytes:
    header = f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header


def archive(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in members.items():
            packed.writestr(f"{name}.npy", content)
    return path


@pytest.mark.parametrize(
    "shape", ["(1000000, 1000000)", "(-1, -4)", "(9" + "9" * 40 + ",)", "(" * 90 + "1" + ",)" * 90]
)
def test_arrays_that_lie_about_their_size(shape: str, tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(array_header(shape))
    archive(tmp_path / "a.npz", data=array_header(shape))
    with limited_memory():
        with pytest.raises(CaptureError, match=r"a\.npy: not a readable \.npy file"):
            read_floats(tmp_path / "a.npy")
        with pytest.raises(CaptureError, match=r"a\.npz: not a readable \.npz file"):
            read_npz(tmp_path / "a.npz", "data")


@pytest.mark.parametrize(
    ("member", "words"),
    [
        (array_header(f"({1 << 38},)"), r"an array of float32 \(274877906944,\)"),
        (array_header(f"({1 << 62}, 8)") + b"1234", "an array of float32"),
        (array_header("(2,)", "'|O'") + pickle.dumps([1, 2]), "holds object, not"),
        (b"\x93NUMPY\x09\x00" + array_header("(2,)")[8:], "version"),
        (b"nothing", "magic string"),
    ],
)
def test_archives_whose_arrays_lie(member: bytes, words: str, tmp_path: Path) -> None:
    with limited_memory(), pytest.raises(ValueError, match=words):
        read_archive(archive(tmp_path / "a.npz", x=member))


def test_archives_larger_than_asked_for_are_not_unpacked(tmp_path: Path) -> None:
    path = archive(tmp_path / "a.npz", x=array_header(f"({1 << 22},)") + bytes(1 << 24))
    assert path.stat().st_size < 1 << 16
    with pytest.raises(ValueError, match=r"more than 0\.001 GB"):
        read_archive(path, 1_000_000)
    assert read_archive(path)["x"].sum() == 0
    archive(path, none=array_header("(0, 3)"), one=array_header("()") + b"\0\0\x80?")
    assert read_archive(path)["none"].shape == (0, 3) and read_archive(path)["one"] == 1.0


# YAML and JSON


def nines(levels: int) -> bytes:
    """A YAML document of a few lines that stands for 9^levels values."""
    names = "abcdefghijklm"
    lines = [f"a: &a [{', '.join('1' * 9)}]"]
    lines += [f"{n}: &{n} [{', '.join([f'*{before}'] * 9)}]" for before, n in pairwise(names[:levels])]
    return "\n".join(lines).encode()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (nines(9), "more than 300000 values"),
        (b"a: &a [*a]", r"\*a stands inside of what it stands for"),
        (b"[" * 100_000, "nested more than 100 levels"),
        (b"- " * 100_000, "nested more than 100 levels"),
        (b"x: " + b"9" * 5000, "a number of 5000 digits"),
        (b"x: 1" + b":59" * 30_000, "a number of 90001 digits"),
        (b"x: " + b"a" * 1_000_000, "line 1: a text of 1000000 signs"),
        (b"[" + b"a," * 400_000 + b"a]", "more than 300000 values"),
        (b"!!python/object/apply:os.system ['touch ranit']", "could not determine a constructor"),
        (b"name: a\nname: b", "'name' is there twice"),
        *((b"!!%b" % each, "a tag") for each in (b"int ''", b"timestamp x", b"bool maybe")),
        (b"2001-99-99", "month must be in 1..12"),
        (b"\xff\xfe\x00", "not readable as YAML"),
    ],
)  # fmt: skip
def test_yaml_that_would_not_end(data: bytes, words: str) -> None:
    with limited_memory(), limited_time(5), pytest.raises(ValueError, match=words) as caught:
        yaml_values(data)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 700


@pytest.mark.parametrize(
    "data", [b"[" * 100_000, b'{"a":' * 100_000, b"9" * 5000, b"NaN", b"[1e999]", b'"\\ud800', b"\xff"]
)
def test_json_that_would_not_end(data: bytes) -> None:
    with limited_memory(), limited_time(5), pytest.raises(ValueError):
        json_values(data)


def test_what_is_just_within_the_limits_is_read() -> None:
    assert yaml_values(b"x: " + b"9" * 400) == {"x": 10**400 - 1}
    assert yaml_values(b"x: 0." + b"5" * 398) == {"x": 5 / 9}
    assert len(yaml_values(b"x: " + b"a" * 100_000)["x"]) == 100_000
    assert yaml_values(b"[" * 100 + b"]" * 100)
    merged = b"usual: &usual {headway_s: 1.5}\nboth: [*usual, {<<: *usual, headway_s: 2}]"
    assert yaml_values(merged)["both"] == [{"headway_s": 1.5}, {"headway_s": 2}]


def test_no_setting_is_nan_or_endless(capsys: pytest.CaptureFixture[str]) -> None:
    check_finite({"a": [1.0, (2.0, "x")]})
    with pytest.raises(ValueError, match=r"got nan - at `\$\.a\[1\]\[0\]`"):
        check_finite({"a": [1.0, (float("nan"), "x")]})
    for arguments in (
        ["recolor", "street", "--images", "x", "-o", "y", "--memory", "nan"],
        ["drive", "--fps", "inf"],
        ["drive", "--exposure", "-inf"],
        ["evaluate", "detection", "--detector", "x", "-o", "y", "--from", "nan"],
    ):
        assert run(arguments) == 2
        error = capsys.readouterr().err.strip()
        assert "\n" not in error and arguments[-2] in error and "finite number" in error


# Files without end


@pytest.mark.parametrize(
    "load", [load_preset, load_calibration, load_scenario, read_any_rollout, read_camera_path, read_json]
)
def test_files_of_ten_gigabytes_are_not_read(load: Callable[[Any], Any], tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    with path.open("wb") as file:
        file.truncate(10 << 30)  # a hole: nothing on the disk
    with limited_memory(), limited_time(5), pytest.raises(ValueError, match=r"settings\.yaml: .*(larger than|not)"):
        load(str(path) if load in (load_preset, load_calibration, load_scenario) else path)


def test_a_log_of_ten_million_lines_is_refused_before_lines_are_made(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_bytes(b"x\n" * 10_000_000)
    with limited_memory(), limited_time(20), pytest.raises(DisdrometerFileError, match="more than 8,000,000 lines"):
        read_disdrometer(path)


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    (reader,) = (each for each in CAPTURE_READERS if each.name == "nerfstudio")
    folder = reader.write(tmp_path)
    for name in ("depth.npy", "images/a.png", "images/b.png"):
        (folder / name).unlink()
        os.mkfifo(folder / name)
    with limited_time(5):
        assert [view.name for view in open_capture(folder)] == ["c"]
    (tmp_path / "endless.json").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "a.safetensors")
    with limited_memory(), limited_time(5):
        with pytest.raises(CaptureError, match="endless.json: not a file"):
            read_json(tmp_path / "endless.json")
        with pytest.raises(OSError, match="not a file but a pipe"):
            read_arrays(tmp_path / "a.safetensors")


def test_a_library_that_does_not_come_to_its_end_is_left(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    endless = tmp_path / "endless.py"
    endless.write_text("while True: pass")
    monkeypatch.setattr(hdf5_trial, "__file__", str(endless))
    monkeypatch.setattr(hdf5_trial, "_MIN_S", 0.2)
    assert not passes_trial(b"")
    endless.write_text("import os; os.abort()")
    monkeypatch.setattr(hdf5_trial, "_MIN_S", 30)
    assert not passes_trial(b"")
    endless.write_text("raise OSError")
    assert passes_trial(b"")


# Networks and replies

LOUD = b"\x80\x04cos\nsystem\n(X\x0b\x00\x00\x00touch ranittR."
"""A pickle that leaves a file called "ranit" behind where somebody runs it."""


@pytest.mark.parametrize("length", [1 << 40, 1 << 63, 0, 2])
def test_safetensors_whose_header_lies(length: int, tmp_path: Path) -> None:
    pytest.importorskip("safetensors")
    path = tmp_path / "a.safetensors"
    path.write_bytes(struct.pack("<Q", length) + b"{}")
    with limited_memory(), nullcontext() if length == 2 else pytest.raises(ValueError, match=r"a\.safetensors: not a"):
        read_arrays(path)


@pytest.mark.parametrize("name", ["a.pt", "a.pth", "a.ckpt"])
def test_weights_that_are_programs_do_not_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if name != "a.ckpt":
        pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    Path(name).write_bytes(LOUD)
    with pytest.raises(ValueError, match=name):
        read_arrays(Path(name))
    assert not Path("ranit").exists()
    pickle.loads(LOUD)  # it is one that would
    assert Path("ranit").exists()


@pytest.mark.parametrize("length", [1 << 20, 1 << 40, (1 << 64) - 1])
def test_replies_that_claim_more_bytes_than_they_have(length: int) -> None:
    with limited_memory(), pytest.raises(ClientError, match="can't be read"):
        read_reply(b"\x80\x04\x8e" + struct.pack("<Q", length) + b"short.")


def test_columns_of_a_rollout_that_unpack_to_far_more(tmp_path: Path) -> None:
    arrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    path = tmp_path / "a.parquet"
    table = arrow.table({"step": arrow.array(np.zeros(2_000_000, np.int64))})
    parquet.write_table(table.replace_schema_metadata({"gsrain.rollout": "{}"}), path)
    assert path.stat().st_size < 100_000
    with pytest.raises(ValueError, match=r"a\.parquet: .* 2000000 rows of .*too large"):
        read_rollout_parquet(path)


@pytest.mark.parametrize(
    ("size", "words"),
    [((1 << 20, 1 << 20), "1048576 x 1048576 px; at most 8192"), ((64, 9000), "9000 x 64 px"), ((0, 64), "size|takes")],
)
def test_detectors_that_take_huge_pictures(size: tuple[int, int], words: str, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    path = write_constant(tmp_path / "a.onnx", [rows()], size, NAMES)
    with limited_memory(), pytest.raises(ValueError, match=f"a.onnx: .*({words})"):
        open_detector(path)


@pytest.mark.parametrize("place", ["../outside.bin", "absolute"])
def test_detectors_whose_numbers_lie_outside_their_folder(place: str, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    import onnx

    outside = tmp_path / "outside.bin"
    outside.write_bytes(np.zeros(1800, np.float32).tobytes())
    (tmp_path / "inside").mkdir()
    path = write_constant(tmp_path / "inside" / "a.onnx", [rows()], metadata=NAMES)
    model = onnx.load(path)
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=str(outside) if place == "absolute" else place)
    path.write_bytes(model.SerializeToString())
    with pytest.raises(ValueError, match=r"a\.onnx: "):
        open_detector(path)
