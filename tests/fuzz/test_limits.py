"""Small files that ask for much: bombs, lying headers and paths out of their folder end before memory is taken."""

import gzip
import io
import os
import pickle
import sqlite3
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from PIL import Image

from gsrain_engine.datasets.bags.containers import McapContainer, SqliteContainer, limit_steps
from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.io.arrays import read_floats, read_json, read_npz
from gsrain_engine.datasets.io.images import image_size, read_color, read_stored
from gsrain_engine.datasets.masks import read_camera_masks
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.waymo import unpacked_matrix
from gsrain_engine.disdrometer import hdf5_trial
from gsrain_engine.disdrometer.hdf5_trial import passes_trial
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError
from gsrain_engine.evaluation.detection.detector import open_detector
from gsrain_engine.evaluation.lpips_weights import read_arrays
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.safe_io.numpy_files import read_archive
from gsrain_engine.safe_io.text_files import check_finite, json_values, yaml_values
from gsrain_engine.scene.camera_path_io import read_camera_path
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.simulation.agents.http import ClientError
from gsrain_engine.simulation.interop.hugsim_protocol import read_reply
from gsrain_engine.simulation.rollout_io import read_any_rollout, read_rollout_parquet
from gsrain_engine.simulation.scenario_io import load_scenario
from tests.evaluation.detection.tiny_onnx import NAMES, rows, write_constant
from tests.scene.formats.sample_files import SOG_COUNT, sog_scene, spz_header, webp, write_sog_folder, zipped

from .capture_readers import CAPTURE_READERS
from .reader import limited_memory, limited_time


@contextmanager
def refused(error: type[Exception] = ValueError, words: str = "", seconds: float = 5) -> Iterator[Any]:
    """Expect an error whose message is one printable line, within little memory and time."""
    with limited_memory(), limited_time(seconds), pytest.raises(error, match=words or None) as caught:
        yield caught
    assert str(caught.value).isprintable() and len(str(caught.value)) < 700


# Scenes


def zstd_bomb() -> bytes:
    frames = [zstandard.compress(bytes(1 << 24))] * 5
    table = b"".join(struct.pack("<QQ", len(frame), 9) for frame in frames)
    return spz_header(4, 1, streams=5) + struct.pack("<I12x", 32) + table + b"".join(frames)


def sog_with(means_l: bytes = b"", **fields: Any) -> bytes:
    meta, files, _ = sog_scene(0)
    return zipped(meta | fields, files | {"means_l.webp": means_l}, zipfile.ZIP_DEFLATED)


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
    with refused(SceneFormatError, rf"{file}: .*{words}"):
        read_scene(tmp_path / file)


def test_as_many_equal_gaussians_as_a_small_file_may_hold_take_little_memory(tmp_path: Path) -> None:
    path, count = tmp_path / "a.spz", 1_000_000
    path.write_bytes(gzip.compress(spz_header(3, count) + bytes(20 * count)))
    assert path.stat().st_size < 30_000
    with limited_memory():
        assert len(read_scene(path).layers[0].gaussians) == count


@pytest.mark.parametrize("name", ["../means_l.webp", "/etc/means_l.webp", "a/means_l.webp", "..\\means_l.webp", ".."])
def test_sog_files_lie_in_the_folder_of_their_description(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    text = (write_sog_folder(folder) / "meta.json").read_text()
    (folder / "meta.json").write_text(text.replace("means_l.webp", name.replace("\\", "\\\\")))
    (tmp_path / "means_l.webp").write_bytes((folder / "means_l.webp").read_bytes())
    with zipfile.ZipFile(tmp_path / "a.sog", "w") as archive:
        for file in folder.iterdir():
            archive.write(file, file.name)
        archive.write(folder / "means_l.webp", name)
    for path in (folder, tmp_path / "a.sog"):
        with refused(SceneFormatError, "meta.json: "):
            read_scene(path)


def test_sog_entries_that_are_links_or_come_twice_reach_nothing_outside(tmp_path: Path) -> None:
    meta, files, _ = sog_scene(0)
    link = zipfile.ZipInfo("means_l.webp")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    path = tmp_path / "a.sog"
    path.write_bytes(zipped(meta, {name: data for name, data in files.items() if name != link.filename}))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(link, b"/etc/passwd")
    with refused(SceneFormatError, r"means_l\.webp is not a WebP image"):
        read_scene(path)
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("means_l.webp", files["means_l.webp"])
    assert len(read_scene(path).layers[0].gaussians) == SOG_COUNT  # the last one counts


# Recordings


def mcap_of_zeros(path: Path, compression: str, messages: int, size: int) -> None:
    writers = pytest.importorskip("mcap.writer")
    with path.open("wb") as stream:
        writer = writers.Writer(stream, chunk_size=1, compression=writers.CompressionType[compression])
        writer.start()
        channel = writer.register_channel("/a", "json", writer.register_schema("a", "jsonschema", b"{}"))
        for time in range(messages):
            writer.add_message(channel, time, bytes(size), time)
        writer.finish()


@pytest.mark.parametrize(("compression", "messages", "size"), [("ZSTD", 1, 80 << 20), ("ZSTD", 30, 3 << 20),
                                                               ("LZ4", 1, 80 << 20), ("LZ4", 30, 3 << 20)])  # fmt: skip
def test_parts_of_an_mcap_file_expand_within_one_budget(
    compression: str, messages: int, size: int, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    mcap_of_zeros(path, compression, messages, size)
    assert path.stat().st_size < 400_000
    bag = McapContainer(path)
    with refused(CaptureError, r"a\.mcap: .*larger than \d+ MB"):
        list(bag.messages())
    with refused(CaptureError, r"a\.mcap: .*larger than \d+ MB"):
        list(bag.copy(tmp_path / "copy.mcap", lambda _: None))
    assert not (tmp_path / "copy.mcap").exists()


def test_an_mcap_file_of_many_gb_takes_no_more_memory_than_its_chunks(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    for compression in ("ZSTD", "LZ4"):
        mcap_of_zeros(path, compression, 2, 1000)
        os.truncate(path, 20 << 30)  # a hole
        with limited_memory():
            messages = list(McapContainer(path).messages())
            assert [McapContainer(path).read(each.place) for each in messages] == [bytes(1000)] * 2


def test_messages_that_are_compressed_one_by_one_expand_within_one_budget(tmp_path: Path) -> None:
    message = zstandard.compress(bytes(3 << 20))
    for count, is_bomb in ((5, False), (30, True)):
        path = database_of(tmp_path / f"{count}.db3", *(
            f"INSERT INTO messages VALUES ({number}, 1, {number}, x'{message.hex()}')" for number in range(count)
        ))  # fmt: skip
        bag = SqliteContainer(path, compressed=True)
        with refused(CaptureError, r"30\.db3: .*larger than \d+ MB") if is_bomb else limited_memory():
            assert [len(each.data) for each in bag.messages()] == [3 << 20] * count


_TABLES = (
    "CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type, serialization_format)",
    "INSERT INTO topics VALUES (1, '/a', 'sensor_msgs/msg/Image', 'cdr')",
)
_MESSAGES = "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data)"
_ENDLESS = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) SELECT"


def database_of(path: Path, *statements: str, tables: tuple[str, ...] = (*_TABLES, _MESSAGES)) -> Path:
    with closing(sqlite3.connect(path)) as database, database:
        for statement in (*tables, *statements):
            database.execute(statement)
    return path


@pytest.mark.parametrize(
    "messages",
    [
        f"CREATE VIEW messages AS {_ENDLESS} k AS id, 1 AS topic_id, k AS timestamp, x'00' AS data FROM n",
        "CREATE VIEW messages AS SELECT 1 AS id, 1 AS topic_id, 1 AS timestamp, zeroblob(500000000) AS data",
        "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data AS (zeroblob(500000000)))",
    ],
    ids=("endless view", "view of zeros", "column of zeros"),
)
def test_databases_deliver_no_more_than_they_hold(messages: str, tmp_path: Path) -> None:
    is_table = messages.startswith("CREATE TABLE")
    rows = ["INSERT INTO messages (id, topic_id, timestamp) VALUES (1, 1, 1)"] if is_table else []
    path = database_of(tmp_path / "a.db3", messages, *rows, tables=_TABLES)
    for read in (lambda: list(SqliteContainer(path).messages()), lambda: open_capture(path)):
        with refused(CaptureError, r"a\.db3: not the database of a ROS 2 bag"):
            read()


def test_a_query_ends_by_its_steps_and_a_file_that_repeats_its_pages_by_its_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing(sqlite3.connect(":memory:")) as database:
        limit_steps(database, 10_000)
        with pytest.raises(sqlite3.OperationalError, match="interrupted"):
            list(database.execute(f"{_ENDLESS} k FROM n WHERE k < 0"))
    rows = (f"INSERT INTO messages VALUES ({number}, 1, {number}, zeroblob(50))" for number in range(3))
    bag = SqliteContainer(database_of(tmp_path / "a.db3", *rows))
    assert len(list(bag.messages())) == 3
    monkeypatch.setattr(SqliteContainer, "_size", lambda _: 120)
    with refused(CaptureError, r"a\.db3: its content is larger than 120 bytes"):
        list(bag.messages())


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
    (tmp_path / name).write_bytes(content)
    for read in (image_size, read_color, read_stored):
        with refused(CaptureError, rf"{name}: .*({words})"):
            read(tmp_path / name)


@pytest.mark.parametrize(("name", "mode"), [("a.png", "RGB"), ("a.jpg", "RGB"), ("m.png", "1")])
def test_pictures_of_one_color_are_no_bombs(name: str, mode: str, tmp_path: Path) -> None:
    Image.new(mode, (5000, 4000)).save(tmp_path / name)
    assert image_size(tmp_path / name) == (5000, 4000)


def array_header(shape: str, kind: str = "'<f4'") -> bytes:
    header = f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header


def archive_of(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in members.items():
            packed.writestr(f"{name}.npy", content)
    return path


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (array_header("(1000000, 1000000)"), "an array of float32"),
        (array_header("(-1, -4)"), "shape"),
        (array_header("(9" + "9" * 40 + ",)"), ""),
        (array_header("(" * 90 + "1" + ",)" * 90), ""),
        (array_header(f"({1 << 62}, 8)") + b"1234", "an array of float32"),
        (array_header("(2,)", "'|O'") + pickle.dumps([1, 2]), "holds object, not"),
        (b"\x93NUMPY\x09\x00" + array_header("(2,)")[8:], "version"),
        (b"nothing", "magic string"),
    ],
)
def test_arrays_that_lie_about_themselves(content: bytes, words: str, tmp_path: Path) -> None:
    archive = archive_of(tmp_path / "a.npz", data=content)
    (tmp_path / "a.npy").write_bytes(content)
    with refused(CaptureError, r"a\.npy: not a readable \.npy file"):
        read_floats(tmp_path / "a.npy")
    with refused(CaptureError, r"a\.npz: not a readable \.npz file"):
        read_npz(archive, "data")
    with refused(ValueError, words):
        read_archive(archive)


def test_masks_of_cameras_are_pictures_with_limits(tmp_path: Path) -> None:
    (tmp_path / "front.png").write_bytes(png(16000, 16000))
    with refused(CaptureError, r"front\.png: "):
        read_camera_masks(tmp_path)


def test_range_images_are_no_larger_than_those_of_lidars() -> None:
    pytest.importorskip("google.protobuf")
    with refused(ValueError, "larger than any lidar's"):
        unpacked_matrix(zlib.compress(bytes(80 << 20)))


def test_a_small_hdf5_file_of_one_number_is_no_large_one(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file.create_dataset("drops", shape=(9000, 9000), dtype="f8", chunks=(900, 900), fillvalue=7.0)
    assert (tmp_path / "a.nc").stat().st_size < 10_000
    with refused(DisdrometerFileError, r"a\.nc: it holds more than 64 MiB", seconds=20):
        read_disdrometer(tmp_path / "a.nc")


def test_archives_larger_than_allowed_are_not_unpacked(tmp_path: Path) -> None:
    large = array_header(f"({1 << 22},)") + bytes(1 << 24)
    path = archive_of(tmp_path / "a.npz", x=large, none=array_header("(0, 3)"), one=array_header("()") + b"\0\0\x80?")
    with refused(ValueError, r"more than 0\.001 GB"):
        read_archive(path, 1_000_000)
    found = read_archive(path)
    assert found["x"].sum() == 0 and found["none"].shape == (0, 3) and found["one"] == 1.0


# YAML and JSON


def nines(levels: int) -> bytes:
    """A YAML document of a few lines that stands for 9^levels values."""
    lines = [f"a: &a [{', '.join('1' * 9)}]"]
    lines += [f"{n}: &{n} [{', '.join([f'*{before}'] * 9)}]" for before, n in pairwise("abcdefghijklm"[:levels])]
    return "\n".join(lines).encode()


@pytest.mark.parametrize(
    ("read", "data", "words"),
    [
        *((yaml_values, data, words) for data, words in (
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
        )),
        *((json_values, data, "") for data in (
            b"[" * 100_000, b'{"a":' * 100_000, b"9" * 5000, b"NaN", b"[1e999]", b'"\\ud800', b"\xff",
        )),
    ],
    ids=range(22),
)  # fmt: skip
def test_text_that_would_not_end(read: Callable[[bytes], Any], data: bytes, words: str) -> None:
    with refused(ValueError, words):
        read(data)


def test_values_just_within_the_limits_are_read() -> None:
    assert yaml_values(b"x: " + b"9" * 400) == {"x": 10**400 - 1}
    assert yaml_values(b"x: 0." + b"5" * 398) == {"x": 5 / 9}
    assert len(yaml_values(b"x: " + b"a" * 100_000)["x"]) == 100_000
    assert yaml_values(b"[" * 100 + b"]" * 100)
    merged = b"usual: &usual {headway_s: 1.5}\nboth: [*usual, {<<: *usual, headway_s: 2}]"
    assert yaml_values(merged)["both"] == [{"headway_s": 1.5}, {"headway_s": 2}]


def test_numbers_that_are_not_finite_are_refused() -> None:
    check_finite({"a": [1.0, (2.0, "x")]})
    with refused(ValueError, r"got nan - at `\$\.a\[1\]\[0\]`"):
        check_finite({"a": [1.0, (float("nan"), "x")]})


# Files without end


@pytest.mark.parametrize(
    "load", [load_preset, load_calibration, load_scenario, read_any_rollout, read_camera_path, read_json]
)
def test_files_of_ten_gigabytes_are_not_read(load: Callable[[Any], Any], tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    with path.open("wb") as file:
        file.truncate(10 << 30)  # a hole: nothing on the disk
    with refused(ValueError, r"settings\.yaml: .*(larger than|not)"):
        load(str(path) if load in (load_preset, load_calibration, load_scenario) else path)


def test_a_log_of_ten_million_lines_is_refused_before_lines_are_made(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_bytes(b"x\n" * 10_000_000)
    with refused(DisdrometerFileError, "more than 8,000,000 lines", seconds=20):
        read_disdrometer(tmp_path / "log.txt")


def test_pipes_in_the_place_of_pictures_are_not_waited_for(tmp_path: Path) -> None:
    (reader,) = (each for each in CAPTURE_READERS if each.name == "nerfstudio")
    folder = reader.write(tmp_path)
    for name in ("depth.npy", "images/a.png", "images/b.png"):
        (folder / name).unlink()
        os.mkfifo(folder / name)
    with limited_time(5):
        assert [view.name for view in open_capture(folder)] == ["c"]


@pytest.mark.parametrize(
    ("text", "seconds", "passes"),
    [("while True: pass", 0.2, False), ("import os; os.abort()", 30, False), ("raise OSError", 30, True)],
)
def test_a_library_that_does_not_end_is_stopped(
    text: str, seconds: float, passes: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "program.py").write_text(text)
    monkeypatch.setattr(hdf5_trial, "__file__", str(tmp_path / "program.py"))
    assert passes_trial(b"", 0, seconds) == passes


# Networks and replies

LOUD = b"\x80\x04cos\nsystem\n(X\x0b\x00\x00\x00touch ranittR."
"""A pickle that leaves a file called "ranit" behind where somebody runs it."""


@pytest.mark.parametrize("length", [1 << 40, 1 << 63, 0])
def test_safetensors_whose_header_lies(length: int, tmp_path: Path) -> None:
    pytest.importorskip("safetensors")
    path = tmp_path / "a.safetensors"
    path.write_bytes(struct.pack("<Q", length) + b"{}")
    with refused(ValueError, r"a\.safetensors: not a"):
        read_arrays(path)


@pytest.mark.parametrize("name", ["a.pt", "a.ckpt"])
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


def test_weights_in_a_zip_file_that_expands_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    path = tmp_path / "a.pt"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/data.pkl", b"\x80\x02}.")
        archive.writestr("a/data/0", bytes(80 << 20))
    with refused(ValueError, r"a\.pt: .*claims to hold 84 MB"):
        read_arrays(path)


@pytest.mark.parametrize("length", [1 << 20, 1 << 40, (1 << 64) - 1])
def test_replies_that_claim_more_bytes_than_they_have(length: int) -> None:
    with refused(ClientError, "can't be read"):
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
    "data", ["../outside.bin", "{outside}", "link.bin", "pipe.bin", "short.bin", "folder", "none.bin"]
)
@pytest.mark.parametrize("offset", [0, 1 << 62])
def test_detectors_whose_numbers_lie_outside_their_folder_or_nowhere(data: str, offset: int, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    import onnx

    outside, inside = tmp_path / "outside.bin", tmp_path / "inside"
    outside.write_bytes(np.zeros(1800, np.float32).tobytes())
    (inside / "folder").mkdir(parents=True)
    (inside / "short.bin").write_bytes(bytes(100))
    (inside / "link.bin").symlink_to(outside)
    os.mkfifo(inside / "pipe.bin")
    path = write_constant(inside / "a.onnx", [rows()], metadata=NAMES)
    model = onnx.load(path)
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=data.format(outside=outside))
    tensor.external_data.add(key="offset", value=str(offset))
    path.write_bytes(model.SerializeToString())
    with limited_time(20), pytest.raises(ValueError, match=r"a\.onnx: "):
        open_detector(path)
