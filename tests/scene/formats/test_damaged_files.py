"""Damaged files: either valid Gaussians come out or one SceneFormatError, whatever bytes are wrong."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.ksplat import write_splat
from gsrain_engine.scene.formats.ply import write_ply
from gsrain_engine.scene.formats.registry import read_gaussians
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.gaussians import Gaussians

from .sample_gaussians import sample_gaussians
from .test_compressed_ply import BOUNDS, compressed
from .test_scene_folder import folder as folder  # a fixture

FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

SMALL = sample_gaussians(7, 1)


def check(path: Path) -> bool:
    """Return whether the file can be read: a scene must be valid, an error must be one line about this file."""
    try:
        gaussians = read_gaussians(path)
    except SceneFormatError as error:
        assert str(error).startswith(f"{path}: ") and "\n" not in str(error)
        return False
    assert_valid(gaussians)
    return True


def assert_valid(g: Gaussians) -> None:
    for values in (g.means, g.scales, g.quaternions, g.opacities, g.sh):
        assert values.dtype == np.float32 and np.isfinite(values).all()
    assert (g.scales >= 0).all() and (g.opacities >= 0).all() and (g.opacities <= 1).all()
    np.testing.assert_allclose(np.linalg.norm(g.quaternions, axis=1), 1, atol=1e-5)


def small_ply(path: Path) -> bytes:
    write_ply(SMALL, path)
    return path.read_bytes()


def small_splat(path: Path) -> bytes:
    write_splat(SMALL, path)
    return path.read_bytes()


FILES: dict[str, Callable[[Path], bytes]] = {
    "a.ply": small_ply,
    "a.compressed.ply": lambda _: compressed(7, 1, BOUNDS, sh_rows=7),
    "a.splat": small_splat,
}


@pytest.mark.parametrize("name", FILES)
def test_cut_off_at_every_byte(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    data = FILES[name](path)
    for size in range(len(data)):
        path.write_bytes(data[:size])
        # A .splat has no header: whole rows are a whole file.
        assert check(path) == (name == "a.splat" and size > 0 and size % 32 == 0)
    path.write_bytes(data)
    assert check(path)


@pytest.mark.parametrize("name", FILES)
@FUZZ
@given(st.data())
def test_any_bytes_changed(name: str, tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / name
    original = FILES[name](path)
    edited = bytearray(original)
    places = st.one_of(st.integers(0, len(original) - 1), st.integers(0, 200))
    for place, value in data.draw(st.lists(st.tuples(places, st.integers(0, 255)), min_size=1, max_size=6)):
        edited[place] = value
    path.write_bytes(edited)
    check(path)


WORDS = [
    *("ply", "format", "comment", "element", "property", "list", "end_header", "vertex", "chunk", "sh"),
    *("float", "uint", "uchar", "int", "x", "f_rest_0", "scale_0", "min_r"),
    *("-1", "0", "1", "7", "8", "4294967295", "1e9", "\n", "\r", "\u00e9", "\0"),
]


@pytest.mark.parametrize("name", ["a.ply", "a.compressed.ply"])
@FUZZ
@given(st.data())
def test_any_words_of_the_header_changed(name: str, tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / name
    header, body = FILES[name](path).split(b"end_header\n", 1)
    lines = [line.split() for line in (header.decode() + "end_header").split("\n")]
    for _ in range(data.draw(st.integers(1, 4))):
        line = data.draw(st.sampled_from(lines))
        place = data.draw(st.integers(0, len(line)))
        line[place : place + data.draw(st.integers(0, 1))] = [data.draw(st.sampled_from(WORDS))]
    path.write_bytes("\n".join(" ".join(line) for line in lines).encode() + b"\n" + body)
    check(path)


@pytest.mark.parametrize("name", FILES)
@FUZZ
@given(st.binary(max_size=300))
def test_anything_at_all(name: str, tmp_path: Path, data: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    check(path)
    path.write_bytes(b"ply\nformat binary_little_endian 1.0\n" + data)
    check(path)


@FUZZ
@given(st.data())
def test_any_bytes_of_a_scene_description_changed(folder: Path, data: st.DataObject) -> None:
    path = folder / "scene.json"
    original = path.read_bytes()
    edited = bytearray(original)
    for place, value in data.draw(
        st.lists(
            st.tuples(st.integers(0, len(original) - 1), st.sampled_from(b'"[]{}0129-.,:eE \\/x\xff')),
            min_size=1,
            max_size=4,
        )
    ):
        edited[place] = value
    if data.draw(st.booleans()):
        del edited[data.draw(st.integers(0, len(edited))) :]
    try:
        path.write_bytes(edited)
        scene = read_scene(folder)
    except SceneFormatError as error:
        assert str(error).startswith(str(folder)) and "\n" not in str(error)
    else:
        assert len(scene.layers) + len(scene.actors) <= 3
    finally:
        path.write_bytes(original)


@pytest.mark.parametrize("count", [8, 2**31, 2**63, 10**40])
def test_lying_counts_take_no_memory(count: int, tmp_path: Path) -> None:
    data = small_ply(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(data.replace(b"vertex 7", f"vertex {count}".encode()))
    assert not check(tmp_path / "a.ply")


def test_a_header_of_60000_properties_takes_no_time(tmp_path: Path) -> None:
    lines = b"".join(b"property char p%d\n" % i for i in range(60_000))
    data = small_ply(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(data.replace(b"property float x\n", lines))
    assert not check(tmp_path / "a.ply")
