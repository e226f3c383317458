"""Settings, logs and messages that would take all memory or time: each is refused in one sentence before it does."""

import io
import json
import os
import pickle
import struct
import zipfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from app.main import run
from gsrain_engine.disdrometer.hdf5_trial import passes_trial
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError
from gsrain_engine.evaluation.detection.detector import open_detector
from gsrain_engine.evaluation.lpips_weights import read_arrays
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.safe_io.numpy_files import read_archive
from gsrain_engine.safe_io.text_files import check_finite, json_values, yaml_values
from gsrain_engine.simulation.agents.http import ClientError
from gsrain_engine.simulation.interop.hugsim_protocol import read_reply
from gsrain_engine.simulation.rollout_io import read_any_rollout, read_rollout_parquet
from gsrain_engine.simulation.scenario_io import load_scenario
from tests.evaluation.detection.tiny_onnx import NAMES, rows, write_constant

from .reader import limited_memory, limited_time

LOUD = b"\x80\x04cos\nsystem\n(X\x0b\x00\x00\x00touch ranittR."
"""A pickle that leaves a file called "ranit" behind where somebody runs it."""


def nines(levels: int) -> bytes:
    """A YAML document of a few lines that stands for 9^levels values."""
    names = "abcdefghijklm"
    lines = [f"a: &a [{', '.join('1' * 9)}]"]
    lines += [f"{n}: &{n} [{', '.join([f'*{before}'] * 9)}]" for before, n in pairwise(names[:levels])]
    return "\n".join(lines).encode()


@pytest.mark.parametrize(
    ("data", "why"),
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
        (b"!!int ''", "a tag"),
        (b"!!timestamp x", "a tag"),
        (b"!!bool maybe", "a tag"),
        (b"2001-99-99", "month must be in 1..12"),
        (b"\xff\xfe\x00", "not readable as YAML"),
    ],
)  # fmt: skip
def test_yaml_that_would_not_end(data: bytes, why: str):
    with limited_memory(), limited_time(5), pytest.raises(ValueError, match=why) as caught:
        yaml_values(data)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 700


def test_what_is_just_within_the_limits_is_read():
    assert yaml_values(b"x: " + b"9" * 400) == {"x": 10**400 - 1}
    assert yaml_values(b"x: 0." + b"5" * 398) == {"x": 5 / 9}
    assert len(yaml_values(b"x: " + b"a" * 100_000)["x"]) == 100_000
    assert yaml_values(b"[" * 100 + b"]" * 100)


def test_aliases_and_merges_are_taken():
    text = b"usual: &usual {headway_s: 1.5}\nboth: [*usual, {<<: *usual, headway_s: 2}]"
    assert yaml_values(text)["both"] == [{"headway_s": 1.5}, {"headway_s": 2}]


@pytest.mark.parametrize(
    "data", [b"[" * 100_000, b'{"a":' * 100_000, b"9" * 5000, b"NaN", b"[1e999]", b'"\\ud800', b"\xff"]
)
def test_json_that_would_not_end(data: bytes):
    with limited_memory(), limited_time(5), pytest.raises(ValueError):
        json_values(data)


def test_no_setting_is_nan_or_endless():
    check_finite({"a": [1.0, (2.0, "x")]})
    with pytest.raises(ValueError, match=r"Expected a finite number, got nan - at `\$\.a\[1\]\[0\]`"):
        check_finite({"a": [1.0, (float("nan"), "x")]})


@pytest.mark.parametrize("load", [load_preset, load_calibration, load_scenario, read_any_rollout])
def test_files_of_ten_gigabytes_are_not_read(load, tmp_path: Path):
    path = tmp_path / "settings.yaml"
    with path.open("wb") as file:
        file.truncate(10 << 30)
    with limited_memory(), limited_time(5), pytest.raises(ValueError, match=r"settings\.yaml: (larger than|not)"):
        load(path if load is read_any_rollout else str(path))


def test_a_log_of_ten_million_lines_is_refused_before_lines_are_made(tmp_path: Path):
    path = tmp_path / "log.txt"
    path.write_bytes(b"x\n" * 10_000_000)
    with limited_memory(), limited_time(20), pytest.raises(DisdrometerFileError, match="more than 8,000,000 lines"):
        read_disdrometer(path)


def archive(**members: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in members.items():
            packed.writestr(f"{name}.npy", content)
    return file.getvalue()


def header(shape: tuple[int, ...], kind: str = "<f4") -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": kind, "fortran_order": False, "shape": shape})
    return file.getvalue()


@pytest.mark.parametrize(
    ("member", "why"),
    [
        (header((1 << 38,)), r"an array of float32 \(274877906944,\) in 128 bytes"),
        (header((1 << 62, 8)) + b"1234", "in 132 bytes"),
        (header((2,), "|O") + pickle.dumps([1, 2]), "holds object, not"),
        (b"\x93NUMPY\x09\x00" + header((2,))[8:], "version"),
        (b"nothing", "magic string"),
    ],
)
def test_archives_that_say_more_than_they_hold(member: bytes, why: str, tmp_path: Path):
    path = tmp_path / "a.npz"
    path.write_bytes(archive(x=member))
    with limited_memory(), pytest.raises(ValueError, match=why):
        read_archive(path)


def test_archives_larger_than_asked_for_are_not_unpacked(tmp_path: Path):
    path = tmp_path / "a.npz"
    path.write_bytes(archive(x=header((1 << 22,)) + bytes(1 << 24)))
    assert path.stat().st_size < 1 << 16
    with pytest.raises(ValueError, match=r"more than 0\.001 GB"):
        read_archive(path, 1_000_000)
    assert read_archive(path)["x"].sum() == 0
    path.write_bytes(archive(none=header((0, 3)), one=header(()) + b"\0\0\x80?"))
    assert read_archive(path)["none"].shape == (0, 3) and read_archive(path)["one"] == 1.0


def test_weights_are_not_waited_for_from_a_pipe(tmp_path: Path):
    pytest.importorskip("safetensors")
    os.mkfifo(tmp_path / "a.safetensors")
    with limited_time(5), pytest.raises(OSError, match="not a file but a pipe"):
        read_arrays(tmp_path / "a.safetensors")


@pytest.mark.parametrize("length", [1 << 40, 1 << 63, 0, 2])
def test_safetensors_whose_header_lies(length: int, tmp_path: Path):
    path = tmp_path / "a.safetensors"
    path.write_bytes(struct.pack("<Q", length) + b"{}")
    with (
        limited_memory(),
        pytest.raises(ValueError, match=r"a\.safetensors: not a readable") if length != 2 else _nothing(),
    ):
        read_arrays(path)


class _nothing:  # noqa: N801 (a context, as pytest.raises is one)
    def __enter__(self):
        return self

    def __exit__(self, *_: object) -> None:
        return None


@pytest.mark.parametrize("name", ["a.pt", "a.pth", "a.ckpt"])
def test_weights_that_are_programs_do_not_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
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
def test_replies_that_claim_more_bytes_than_they_have(length: int):
    with limited_memory(), pytest.raises(ClientError, match="can't be read"):
        read_reply(b"\x80\x04\x8e" + struct.pack("<Q", length) + b"short.")


def test_columns_of_a_rollout_that_unpack_to_far_more(tmp_path: Path):
    arrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    path = tmp_path / "a.parquet"
    table = arrow.table({"step": arrow.array(np.zeros(2_000_000, np.int64))}).replace_schema_metadata(
        {"gsrain.rollout": "{}"}
    )
    parquet.write_table(table, path)
    assert path.stat().st_size < 100_000
    with pytest.raises(ValueError, match=r"a\.parquet: .* 2000000 rows of .*too large"):
        read_rollout_parquet(path)


@pytest.mark.parametrize(
    ("size", "why"),
    [
        ((1 << 20, 1 << 20), "1048576 x 1048576 px; at most 8192"),
        ((64, 9000), "9000 x 64 px"),
        ((0, 64), "any size|takes"),
    ],
)
def test_detectors_that_take_huge_pictures(size: tuple[int, int], why: str, tmp_path: Path):
    pytest.importorskip("onnxruntime")
    path = write_constant(tmp_path / "a.onnx", [rows()], size, NAMES)
    with limited_memory(), pytest.raises(ValueError, match=f"a.onnx: .*({why})"):
        open_detector(path)


@pytest.mark.parametrize("place", ["../outside.bin", "absolute"])
def test_detectors_whose_numbers_lie_outside_their_folder(place: str, tmp_path: Path):
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


def test_a_library_that_does_not_come_to_its_end_is_left(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    from gsrain_engine.disdrometer import hdf5_trial

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


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (["recolor", "street", "--images", "x", "-o", "y", "--memory", "nan"], "--memory"),
        (["drive", "--fps", "inf"], "--fps"),
        (["drive", "--exposure", "-inf"], "--exposure"),
        (["evaluate", "detection", "--detector", "x", "-o", "y", "--from", "nan"], "--from"),
    ],
)
def test_options_take_no_nan_and_no_infinity(arguments: list[str], option: str, capsys: pytest.CaptureFixture[str]):
    assert run(arguments) == 2
    said = capsys.readouterr().err.strip()
    assert "\n" not in said and option in said and "finite number" in said


def test_json_of_settings_is_as_bounded_as_yaml(tmp_path: Path):
    path = tmp_path / "rain.yaml"
    path.write_text(json.dumps({"intensity_mm_h": 3.0}))
    assert load_preset(str(path)).intensity_mm_h == 3.0
    os.truncate(path, 5)
    with pytest.raises(ValueError, match=r"rain\.yaml: not readable as YAML"):
        load_preset(str(path))
