"""Damaged files: refused by one line that names the file and what is wrong; `tests/fuzz` damages them at random."""

import gzip
import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats.registry import FORMATS, read_gaussians
from gsrain_engine.scene.gaussians import COEFFICIENTS_OF_DEGREE

from .sample_files import (
    BOUNDS,
    SMALL_FILES,
    assert_valid,
    compressed,
    ksplat,
    sample_gaussians,
    sog_scene,
    sog_version_1,
    spz_header,
    webp,
    write_small,
    written,
    zipped,
)
from .test_layouts import columns_of, ply_of, write_text

inf, nan = np.inf, np.nan


def refusal(path: Path) -> str:
    with pytest.raises(SceneFormatError) as error:
        read_gaussians(path)
    assert str(error.value).startswith(f"{path}: ") and "\n" not in str(error.value)
    return str(error.value).removeprefix(f"{path}: ")


def test_every_format_has_a_small_file() -> None:
    suffixes = [each.suffix for each in FORMATS if not each.suffix.endswith("meta.json")]
    assert all(any(file.endswith(suffix) for file, _ in SMALL_FILES.values()) for suffix in suffixes)


@pytest.mark.parametrize("name", SMALL_FILES)
def test_files_that_are_cut_off_anywhere_are_refused(name: str, tmp_path: Path) -> None:
    path = write_small(name, tmp_path)
    data = path.read_bytes()
    assert_valid(read_gaussians(path))
    for size in [*range(0, len(data), 1 + len(data) // 900), len(data) - 1]:
        path.write_bytes(data[:size])
        if name == "splat" and size > 0 and size % 32 == 0:
            read_gaussians(path)  # a .splat has no header: whole rows are a whole file
        else:
            refusal(path)


# Each format's own contradictions


def ply(old: bytes = b"", new: bytes = b"") -> bytes:
    data = written(sample_gaussians(), ".ply")
    assert old in data
    return data.replace(old, new, 1)


def ply_with(bad: float, *columns: str, count: int = 31) -> bytes:
    """A PLY of 300 Gaussians, some of which, from number 7 on, have a number that no Gaussian has."""
    names, values = columns_of(ply())
    values = values.copy()
    values[np.ix_(range(7, 7 + count), [names.index(name) for name in columns])] = bad
    return ply_of(names, values)


def text_ply(change: Callable[[bytes], bytes]) -> bytes:
    header, mark, lines = write_text(ply()).partition(b"end_header\n")
    return header + mark + change(lines)


def packed(old: bytes = b"", new: bytes = b"", **more: int) -> bytes:
    return compressed(9, 1, BOUNDS, **more).replace(old, new)


def packed_bounds(value: int, bad: float) -> bytes:
    data = bytearray(packed())
    start = data.index(b"end_header\n") + len(b"end_header\n") + 4 * value
    data[start : start + 8] = np.array([bad, bad], "<f4").tobytes()
    return bytes(data)


def splat_with(columns: slice, bad: float | int) -> bytes:
    rows = np.frombuffer(written(sample_gaussians(5), ".splat"), np.uint8).reshape(5, 32).copy()
    rows[3, columns] = bad if isinstance(bad, int) else np.array([bad], "<f4").view(np.uint8)
    return rows.tobytes()


def patched(level: int, offset: int, form: str, *values: float, count: int = 40) -> bytes:
    data = bytearray(ksplat([sample_gaussians(count, 2)], level)[1])
    struct.pack_into(form, data, offset, *values)
    return bytes(data)


def gz(*parts: bytes) -> bytes:
    return gzip.compress(b"".join(parts), mtime=0)


def streams(packed_size: int, unpacked_size: int) -> bytes:
    """SPZ version 4 with one Gaussian, whose five streams all have these sizes."""
    head = spz_header(4, 1, streams=5) + struct.pack("<I12x", 32)
    return head + struct.pack("<QQ", packed_size, unpacked_size) * 5


def zstd_frame(window_log: int) -> bytes:
    """Nine zeros in 18 bytes, to be unpacked in a window of that size (RFC 8878, section 3.1.1)."""
    block = (1 | 9 << 3).to_bytes(3, "little") + bytes(9)  # the last one, as it is
    return b"\x28\xb5\x2f\xfd\0" + bytes([(window_log - 10) << 3]) + block


def changed(path: str, value: Any) -> bytes:
    """A SOG of which one field of the description is another."""
    meta, files, _ = sog_scene()
    *parents, last = path.split(".")
    place = meta
    for name in parents:
        place = place[name]
    place[last] = value
    return zipped(meta, files)


def version_1(name: str, **fields: Any) -> bytes:
    """A SOG of version 1 of which some fields of one part of the description are others."""
    meta, files, _ = sog_scene()
    old = sog_version_1(meta)
    return zipped({**old, name: {**old[name], **fields}}, files)


def with_file(name: str, data: bytes | None) -> bytes:
    """A SOG with another file, or without it."""
    meta, files, _ = sog_scene()
    return zipped(meta, {key: content for key, content in (files | {name: data}).items() if content is not None})


def with_meta(text: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("meta.json", text)
    return file.getvalue()


def with_password() -> bytes:
    data = bytearray(zipped(*sog_scene()[:2]))
    data[data.index(b"PK\x01\x02") + 8] |= 1  # in the directory of the archive
    return bytes(data)


def canvas_larger_than_its_image() -> bytes:
    """libwebp would allocate 16384 x 16384 pixels for it."""
    canvas = b"VP8X" + struct.pack("<I", 10) + b"\x10\0\0\0" + b"\xff\x3f\0" * 2
    body = b"WEBP" + canvas + webp(EMPTY)[12:]
    return b"RIFF" + struct.pack("<I", len(body)) + body


def glb(path: str = "", value: Any = None) -> bytes:
    """A binary glTF file of which one value of the description, by its path of keys and indices, is another."""
    data = written(sample_gaussians(5, 1), ".glb")
    (length,) = struct.unpack_from("<I", data, 12)
    values = json.loads(data[20 : 20 + length])
    *parents, last = [int(key) if key.isdigit() else key for key in path.split("/")]
    place = values
    for key in parents:
        place = place[key]
    place[last] = value
    text = json.dumps(values).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


_SPLAT = "meshes/0/primitives/0/"
EMPTY = np.zeros((5, 8, 4), np.uint8)

DAMAGED: list[tuple[str, Callable[[], bytes], str]] = [
    # the header of a PLY
    ("a.ply", lambda: ply(b"ply\n", b"plx\n"), "line 'ply'"),
    ("a.ply", lambda: ply(b"binary_little_endian", b"ascii"), "vertex 0"),
    ("a.ply", lambda: ply(b"binary_little_endian", b"binary_middle_endian"), "binary_little_endian 1.0"),
    ("a.ply", lambda: ply(b"end_header", b"end_headed"), "'end_header'"),
    ("a.ply", lambda: ply(b"element vertex", b"element vortex"), "'vertex', not vortex"),
    ("a.ply", lambda: ply(b"vertex 300", b"vertex 300000000000"), "300000000000 vertex"),
    ("a.ply", lambda: ply(b"vertex 300", b"vertex " + b"9" * 5000), "cut off or its counts are wrong"),
    ("a.ply", lambda: ply(b"vertex 300", b"vertex -1"), "'element vertex -1'"),
    ("a.ply", lambda: ply(b"property float x", b"property quad x"), "'property quad x'"),
    ("a.ply", lambda: ply(b"property float nx", b"property list uchar int nx"), "list property"),
    ("a.ply", lambda: ply(b"property float nx", b"property float x"), "'x' twice"),
    ("a.ply", lambda: ply(b"property float opacity", b"property float opalcity"), "no property opacity"),
    ("a.ply", lambda: ply(b"property float f_rest_44", b"property float e_rest_44"), "44 properties f_rest_*"),
    ("a.ply", lambda: ply(b"property float f_rest_44", b"property float f_rest_45"), "counted from f_rest_0"),
    ("a.ply", lambda: ply(b"property float x\n", b"property char p\n" * 60_000), "'p' twice"),
    ("a.ply", lambda: text_ply(lambda lines: b"\n".join(lines.split(b"\n")[:280])), "vertex 280: 0 numbers"),
    ("a.ply", lambda: text_ply(lambda lines: b"half " + lines), "vertex 0: 63 numbers"),
    ("a.ply", lambda: text_ply(lambda lines: b"half " + lines.split(b" ", 1)[1]), "vertices 0 to 299"),
    ("a.ply", lambda: write_text(ply()).replace(b"vertex 300", b"vertex 300000000"), "at least"),
    ("a.ply", lambda: text_ply(lambda lines: b" " * 2**14 + lines), "vertex 0: 0 numbers"),
    ("a.ply", lambda: ply(b"end_header", b"comment" + b" " * 2**20 + b"\nend_header"), "in its first 1048576 bytes"),
    # values of a PLY
    ("a.ply", lambda: ply_with(nan, "x"), "31 of 300 Gaussians have a mean that is not a finite number"),
    ("a.ply", lambda: ply_with(-inf, "x"), "31 of 300 Gaussians have a mean"),
    ("a.ply", lambda: ply_with(inf, "f_rest_44"), "31 of 300 Gaussians have a color"),
    ("a.ply", lambda: ply_with(100, "scale_1"), "31 of 300 Gaussians have a scale"),
    ("a.ply", lambda: ply_with(nan, "opacity"), "31 of 300 Gaussians have an opacity"),
    ("a.ply", lambda: ply_with(-inf, "rot_0"), "31 of 300 Gaussians have a quaternion"),
    ("a.ply", lambda: ply_with(1e30, "rot_3"), "a quaternion too long"),
    ("a.ply", lambda: ply_with(0, "rot_0", "rot_1", "rot_2", "rot_3"), "a zero quaternion"),
    # compressed PLY
    ("a.ply", lambda: compressed(257, 1, BOUNDS), "need 2 chunks"),
    ("a.ply", lambda: compressed(1, 1, BOUNDS[:2]), "'chunk' of a compressed PLY lacks min_z, max_z, min_scale_x"),
    ("a.ply", lambda: packed(b"packed_scale", b"packed_scald"), "packed_scale"),
    ("a.ply", lambda: packed(b"uint packed_scale", b"int packed_scale"), "packed_scale of a compressed PLY must be"),
    ("a.ply", lambda: packed(b"uchar f_rest_3", b"char f_rest_3", sh_rows=9), "f_rest_3 of a compressed PLY"),
    ("a.ply", lambda: packed(sh_rows=9, sh_columns=12), "'sh' has 9 rows of 12 f_rest_*"),
    ("a.ply", lambda: packed(sh_rows=8), "'sh' has 8 rows"),
    *(("a.ply", lambda bad=bad: packed_bounds(0, bad), "9 of 9 Gaussians have a mean") for bad in (nan, inf)),
    *(("a.ply", lambda bad=bad: packed_bounds(6, bad), "9 of 9 Gaussians have a scale")
      for bad in (nan, inf)),
    # .splat
    *(("a.splat", lambda size=size: bytes(size), f"{size} bytes") for size in (0, 31, 33)),
    ("a.splat", lambda: splat_with(slice(28, 32), 128), "zero quaternion, the first is number 3"),
    ("a.splat", lambda: splat_with(slice(12, 16), -0.5), "1 of 5 Gaussians have a negative scale"),
    ("a.splat", lambda: splat_with(slice(4, 8), nan), "1 of 5 Gaussians have a mean"),
    # KSPLAT
    ("a.ksplat", lambda: bytes(5000), "version is 0.0"),
    ("a.ksplat", lambda: patched(0, 4, "<I", 2**32 - 1), "4294967295 sections"),
    ("a.ksplat", lambda: patched(0, 16, "<I", 41), "the header says 41"),
    ("a.ksplat", lambda: patched(0, 20, "<H", 3), "compression level 3"),
    ("a.ksplat", lambda: patched(0, 4096 + 4, "<I", 2**32 - 1), "section 0 ends at byte"),
    ("a.ksplat", lambda: patched(0, 4096, "<I", 41), "section 0 has room for 40"),
    ("a.ksplat", lambda: patched(0, 4096 + 40, "<H", 3), "section 0: SH degree 3"),
    ("a.ksplat", lambda: patched(2, 36, "<ff", 1, 0.5), "8-bit harmonics"),
    ("a.ksplat", lambda: patched(1, 4096 + 20, "<H", 8), "buckets of 8 bytes"),
    ("a.ksplat", lambda: patched(1, 4096 + 12, "<I", 2**32 - 1), "section 0 ends at byte"),
    ("a.ksplat", lambda: patched(1, 4096 + 32, "<I", 2**32 - 1), "4294967295 full"),
    ("a.ksplat", lambda: patched(1, 5120, "<I", 0), "of its 40 Gaussians"),
    ("a.ksplat", lambda: patched(0, 5120 + 4, "<f", nan, count=5), "a mean that is not a finite number"),
    ("a.ksplat", lambda: patched(0, 5120 + 12, "<f", -1, count=5), "negative scale"),
    ("a.ksplat", lambda: patched(0, 5120 + 24, "<4f", 0, 0, 0, 0, count=5), "zero quaternion"),
    ("a.ksplat", lambda: patched(0, 5120 + 24, "<f", -1e30, count=5), "a quaternion too long"),
    # SPZ
    ("a.spz", lambda: b"", "header of 16 bytes"),
    ("a.spz", lambda: b"PLY file, not SPZ", "NGSP"),
    ("a.spz", lambda: spz_header(5, 0), "version 5"),
    ("a.spz", lambda: spz_header(3, 0, degree=4), "SH degree 4"),
    ("a.spz", lambda: spz_header(3, 0, bits=24), "24 fractional bits"),
    ("a.spz", lambda: gz(spz_header(3, 9, bits=23), bytes(10)), "9 Gaussians of SH degree 0 take 196 bytes"),
    ("a.spz", lambda: gz(spz_header(4, 0)), "version 4 inside gzip"),
    ("a.spz", lambda: spz_header(4, 10, streams=7) + bytes(200), "7 streams"),
    ("a.spz", lambda: spz_header(4, 10, streams=5) + struct.pack("<I12x", 2**31) + bytes(200), "table of contents"),
    ("a.spz", lambda: streams(1, 2**60) + bytes(9), "stream of means must hold 9 bytes"),
    ("a.spz", lambda: streams(2**60, 9), "cut off"),
    ("a.spz", lambda: streams(4, 9) + bytes(20), "zstd stream of means"),
    ("a.spz", lambda: streams(18, 9) + 5 * zstd_frame(28), "zstd stream of means is damaged"),
    ("a.spz", lambda: streams(18, 9) + 5 * zstd_frame(27), "stream of opacities must hold 1 bytes"),  # means are read
    *(("a.spz", lambda bad=bad: spz_header(1, 1, bits=0) + struct.pack("<3e", 0, bad, 0) + bytes(10), "a mean")
      for bad in (nan, inf, -inf)),
    ("a.spz", lambda: spz_header(4, 0, flags=2, streams=5) + struct.pack("<I12xIIi", 44, 0xADBE0003, 4, 7) + bytes(99),
     "must be 4, RUB, not 7"),
    # binary glTF
    ("a.glb", lambda: b"glTF", "at least 20 bytes"),
    ("a.glb", lambda: b"glTF\1" + bytes(30), "version 2"),
    ("a.glb", lambda: glb("asset", {})[:-9], "it is cut off"),
    ("a.glb", lambda: glb("extensionsRequired", ["EXT_meshopt_compression"]), "EXT_meshopt_compression, which is not"),
    ("a.glb", lambda: glb("nodes", "many"), "$.nodes"),
    ("a.glb", lambda: glb("nodes/0/mesh", 7), "no number 7 in meshes"),
    ("a.glb", lambda: glb("nodes/0/children", [0]), "node 0 has several parents"),
    ("a.glb", lambda: glb("nodes/0/scale", [1, 2, 1]), "equally along all axes"),
    ("a.glb", lambda: glb("nodes/0/scale", [1e200, 1e200, 1e200]), "equally along all axes"),
    ("a.glb", lambda: glb("nodes/0/translation", [1e300, 0, 0]), "a mean that is not a finite number"),
    ("a.glb", lambda: glb(_SPLAT + "mode", 4), "mode 0, not 4"),
    ("a.glb", lambda: glb(_SPLAT + "extensions", {}), "none of its meshes has Gaussians"),
    ("a.glb", lambda: glb(_SPLAT + "extensions/KHR_gaussian_splatting/kernel", "box"), "kernel 'box'"),
    ("a.glb", lambda: glb(_SPLAT + "extensions/KHR_gaussian_splatting/colorSpace", "lin_rec709_display"), "colorSpace"),
    ("a.glb", lambda: glb(_SPLAT + "attributes/KHR_gaussian_splatting:SH_DEGREE_2_COEF_0", 5), "5 attributes SH_"),
    ("a.glb", lambda: glb(_SPLAT + "attributes", {"POSITION": 0}), "0 attributes SH_DEGREE"),
    ("a.glb", lambda: glb(_SPLAT + "attributes/KHR_gaussian_splatting:SCALE", 4), "SCALE is 'SCALAR'"),
    ("a.glb", lambda: glb("accessors/2/count", 4), "not as many rows as the 5"),
    ("a.glb", lambda: glb("accessors/2/sparse", {}), "without `sparse`"),
    ("a.glb", lambda: glb("accessors/3/byteOffset", 4), "SCALE ends at byte 64 of a bufferView of 60"),
    ("a.glb", lambda: glb("bufferViews/3/byteLength", 2**40), "bufferView 3 ends at byte"),
    ("a.glb", lambda: glb("buffers/0/uri", "/etc/passwd"), "must be a file next to it"),
    ("a.glb", lambda: glb("bufferViews/4/byteOffset", 0), "have an opacity outside 0 to 1"),
    # SOG
    ("a.sog", lambda: b"", "zip"),
    ("a.sog", lambda: b"PK\x03\x04abc", "zip"),
    ("a.sog", with_password, "password"),
    ("a.sog", lambda: with_file("sh0.webp", None), "sh0.webp"),
    ("a.sog", lambda: version_1("means", shape=[-1]), "means.shape"),
    ("a.sog", lambda: version_1("sh0", mins=[0, 0, 0]), "must hold 4 numbers"),
    ("a.sog", lambda: changed("version", 3), "version 3"),
    ("a.sog", lambda: changed("count", "many"), "$.count"),
    ("a.sog", lambda: changed("count", -1), "$.count"),
    ("a.sog", lambda: changed("count", 41), "means_l.webp has 8 x 5 pixels"),
    ("a.sog", lambda: changed("means.mins", [0, 0]), "$.means.mins"),
    ("a.sog", lambda: changed("means.maxs", [1e30, 1, 1]), "a mean"),
    ("a.sog", lambda: changed("quats.files", [".."]), "'..'"),
    ("a.sog", lambda: changed("quats.files", ["quats.webp"] * 2), "$.quats.files"),
    ("a.sog", lambda: changed("quats.files", ["q" * 255]), f"there is no {'q' * 255}"),
    ("a.sog", lambda: changed("quats.files", ["q" * 256]), f"'{'q' * 40}' is not the name"),
    ("a.sog", lambda: changed("scales.codebook", [0.0] * 257), "$.scales.codebook"),
    ("a.sog", lambda: changed("scales.codebook", [1e4] * 256), "a scale"),
    ("a.sog", lambda: changed("sh0.codebook", [0.0, 1.0]), "a color"),
    ("a.sog", lambda: changed("sh0.codebook", [0.0, None]), "sh0.codebook"),
    ("a.sog", lambda: changed("shN.bands", 4), "$.shN.bands"),
    ("a.sog", lambda: changed("shN.bands", 3), "centroids.webp is 512 pixels wide, [960]"),
    ("a.sog", lambda: changed("shN.count", 1000), "centroids.webp has room for 320 entries"),
    ("a.sog", lambda: changed("shN.count", 20), "the last one is 19"),
    ("a.sog", lambda: changed("shN.count", 2**16 + 1), "$.shN.count"),
    ("a.sog", lambda: with_file("centroids.webp", webp(np.zeros((1025, 512, 4), np.uint8))), "room for 65600 entries"),
    ("a.sog", lambda: with_meta(b" " * (2**20 + 1)), "meta.json has 1048577 bytes, at most 1048576"),
    ("a.sog", lambda: with_file("quats.webp", webp(EMPTY)), "quaternions have an alpha below 252"),
    ("a.sog", lambda: with_file("quats.webp", b"not an image"), "quats.webp is not a WebP"),
    ("a.sog", lambda: with_file("quats.webp", webp(EMPTY, lossless=False, quality=80)), "single lossless"),
    ("a.sog", lambda: with_file("quats.webp", canvas_larger_than_its_image()), "(16384, 16384) pixels"),
    ("a.sog", lambda: with_file("sh0.webp", webp(np.zeros((600, 600, 4), np.uint8))), "sh0.webp has 600 x 600"),
    ("a.sog", lambda: with_file("sh0.webp", sog_scene()[1]["sh0.webp"][:-20]), "sh0.webp is damaged"),
    *(("a.sog", lambda text=text: with_meta(text), "meta.json: ")
      for text in (b"[" * 100_000, b"\xff\xfe", b"nonsense", b"[]", b'{"version": "2"}', b"{}")),
    ("a.sog", lambda: with_meta(json.dumps({**sog_scene()[0], "version": 1}).encode()), "meta.json: "),
]  # fmt: skip
"""File, content, and the name of the field or part that is wrong."""


@pytest.mark.parametrize(("file", "content", "field"), DAMAGED, ids=[f"{row[0][2:]}: {row[2]}" for row in DAMAGED])
def test_what_is_wrong_is_named(file: str, content: Callable[[], bytes], field: str, tmp_path: Path) -> None:
    (tmp_path / file).write_bytes(content())
    assert field in refusal(tmp_path / file)


# Memory


@pytest.mark.parametrize(("size", "most"), [(16, 2**26 // 56), (400_000, 200 * 400_000 // 56)])
def test_a_small_file_may_take_64_mb_and_a_larger_one_200_times_its_size(size: int, most: int, tmp_path: Path) -> None:
    for count, reason in ((most, "take"), (most + 1, "speaks of")):  # a Gaussian without harmonics takes 56 bytes
        (tmp_path / "a.spz").write_bytes(spz_header(3, count).ljust(size, b"\0"))
        assert reason in refusal(tmp_path / "a.spz")


COEFFICIENTS = {"compressed-ply": 16, "ksplat-0": 9, "ksplat-1": 9, "ksplat-2": 9}
"""Of the most harmonics that a file may have, where its header does not say how many there are."""


@pytest.mark.parametrize("name", SMALL_FILES)
def test_every_format_looks_for_room_before_it_reads(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_small(name, tmp_path)
    gaussians = read_gaussians(path)
    needed = 1.6 * 4 * len(gaussians) * (11 + 3 * COEFFICIENTS.get(name, COEFFICIENTS_OF_DEGREE[gaussians.sh_degree]))
    memory = SimpleNamespace(available=0.0)
    monkeypatch.setattr("psutil.virtual_memory", lambda: memory)
    for memory.available in (0.0, needed - 1):
        assert refusal(path).startswith(f"{len(gaussians)} Gaussians need")
    memory.available = needed
    assert len(read_gaussians(path)) == len(gaussians)
