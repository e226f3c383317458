"""Random Gaussians, and small files of every scene format and version, also of those that GSRAIN does not write."""

import base64
import gzip
import io
import json
import struct
import zipfile
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import zstandard
from PIL import Image

from gsrain_engine.scene.formats.registry import writable_suffixes, write_gaussians
from gsrain_engine.scene.formats.spz import encode_spz
from gsrain_engine.scene.gaussians import COEFFICIENTS_OF_DEGREE, SH_C0, Gaussians
from gsrain_engine.scene.geometry import normalized


def sample_gaussians(count: int = 300, sh_degree: int = 3, seed: int = 1) -> Gaussians:
    """Gaussians whose values all formats can hold."""
    rng = np.random.default_rng(seed)
    return Gaussians(
        rng.normal(0, 5, (count, 3)).astype(np.float32),
        rng.uniform(0.005, 0.5, (count, 3)).astype(np.float32),
        normalized(rng.normal(size=(count, 4))).astype(np.float32),
        rng.uniform(0, 1, count).astype(np.float32),
        rng.uniform(-0.9, 0.9, (count, COEFFICIENTS_OF_DEGREE[sh_degree], 3)).astype(np.float32),
    )


def assert_equal(found: Gaussians, expected: Gaussians, rtol: float = 1e-5) -> None:
    np.testing.assert_array_equal(found.means, expected.means)
    np.testing.assert_array_equal(found.sh, expected.sh)
    np.testing.assert_allclose(found.scales, expected.scales, rtol=rtol)
    np.testing.assert_allclose(found.quaternions, expected.quaternions, atol=1e-6)
    np.testing.assert_allclose(found.opacities, expected.opacities, rtol=rtol, atol=1e-7)


def assert_valid(found: Gaussians) -> None:
    """Assert that Gaussians are what their class says."""
    for values in found.arrays:
        assert values.dtype == np.float32, f"holds {values.dtype}"
        assert np.isfinite(values).all(), "holds numbers that are not finite"
        assert values.flags.c_contiguous and values.flags.writeable, "can't be sorted in place"
    assert (found.scales >= 0).all(), "holds a scale below 0"
    assert ((found.opacities >= 0) & (found.opacities <= 1)).all(), "holds an opacity outside 0..1"
    assert np.allclose(np.linalg.norm(found.quaternions, axis=1), 1, atol=1e-5), "holds a quaternion that is not unit"


# Compressed PLY

BOUNDS = ["x", "y", "z", "scale_x", "scale_y", "scale_z", "r", "g", "b"]


def compressed(count: int, chunks: int, bounds: list[str], sh_rows: int = 0, sh_columns: int = 9) -> bytes:
    """A compressed PLY of equal Gaussians in the middle of their bounds, -1 .. 1 for all."""
    lines = [f"element chunk {chunks}", *(f"property float {end}_{name}" for name in bounds for end in ("min", "max"))]
    words = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
    lines += [f"element vertex {count}", *(f"property uint {word}" for word in words)]
    if sh_rows:
        lines += [f"element sh {sh_rows}", *(f"property uchar f_rest_{i}" for i in range(sh_columns))]
    header = "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""]).encode()
    body = np.tile(np.array([-1, 1], "<f4"), (chunks, len(bounds))).tobytes()
    # Largest is y (2), the others 512/1023: 0.0007; color 51, 102, 255 of 255; opacity 204 of 255.
    word = [1024 << 21 | 512 << 11 | 1024, 2 << 30 | 512 << 20 | 512 << 10 | 512, 2047 << 21, 0x3366FFCC]
    body += np.tile(np.array(word, "<u4"), (count, 1)).tobytes()
    return header + body + bytes([0, 255, 128] * (sh_rows * sh_columns // 3))


# SPZ


def spz_header(version: int, count: int, degree: int = 0, bits: int = 12, flags: int = 0, streams: int = 0) -> bytes:
    return struct.pack("<4sII4B", b"NGSP", version, count, degree, bits, flags, streams)


def spz_streams(gaussians: Gaussians) -> tuple[bytes, list[bytes]]:
    """Header of 16 bytes and the attributes in file order, from the version that is written."""
    data = encode_spz(gaussians)
    table = [struct.unpack_from("<QQ", data, 32 + 16 * i) for i in range(data[15])]
    ends = np.cumsum([32 + 16 * data[15], *(size for size, _ in table)]).tolist()
    frames = [data[start:end] for start, end in pairwise(ends)]
    return data[:16], [
        zstandard.decompress(frame) if size else b"" for frame, (_, size) in zip(frames, table, strict=True)
    ]


def old_spz(gaussians: Gaussians, version: int) -> bytes:
    """Versions 1 to 3: the same attributes in one gzip stream, versions 1 and 2 with other means and quaternions."""
    header, streams = spz_streams(gaussians)
    n = len(gaussians)
    if version == 1:
        streams[0] = np.linspace(-2, 2, 3 * n).astype("<f2").tobytes()
    if version < 3:
        streams[4] = bytes(range(100, 100 + 3 * n))
    return gzip.compress(header[:4] + struct.pack("<I", version) + header[8:15] + b"\0" + b"".join(streams), mtime=0)


# KSPLAT
# No real file of levels 1 and 2 is free to ship: this encoder follows `SplatBuffer.js` (mkkellogg, MIT).

BLOCK = 5.0
_BUCKET = 16


def ksplat(parts: list[Gaussians], level: int) -> tuple[Gaussians, bytes]:
    """Gaussians in the order of the file, and the file, with a section for each part."""
    sections = [_ksplat_section(part, level) for part in parts]
    n = sum(map(len, parts))
    header = struct.pack("<BBxxIIIIHxx3fff", 0, 1, len(parts), len(parts), n, n, level, 0, 0, 0, 0, 0)
    data = header.ljust(4096, b"\0") + b"".join(s[1] for s in sections) + b"".join(s[2] for s in sections)
    return Gaussians.concatenate([s[0] for s in sections]), data


def _into_buckets(g: Gaussians) -> tuple[Gaussians, np.ndarray, list[int], int]:
    """Sort by 5 m block and cut into buckets of 16, full ones first; centers, lengths of the others, number of full."""
    blocks = np.floor(g.means / BLOCK)
    order = np.lexsort(blocks.T)
    starts = np.flatnonzero(np.r_[True, np.any(np.diff(blocks[order], axis=0) != 0, axis=1)])
    pieces = [p[i : i + _BUCKET] for p in np.split(order, starts[1:]) for i in range(0, len(p), _BUCKET)]
    pieces.sort(key=lambda piece: len(piece) < _BUCKET)
    centers = np.array([(blocks[piece[0]] + 0.5) * BLOCK for piece in pieces], np.float32)
    full = sum(len(piece) == _BUCKET for piece in pieces)
    return g.take(np.concatenate(pieces)), centers, [len(piece) for piece in pieces[full:]], full


def _ksplat_section(g: Gaussians, level: int) -> tuple[Gaussians, bytes, bytes]:
    """Gaussians in file order, section header, section."""
    centers, lengths, full = np.zeros((0, 3), np.float32), [], 0
    stored = g.means.astype("<f4")
    if level:
        g, centers, lengths, full = _into_buckets(g)
        center = np.repeat(centers, [_BUCKET] * full + lengths, axis=0)
        stored = np.clip(np.round((g.means - center) * (32767 / (BLOCK / 2))) + 32767, 0, 65535).astype("<u2")
    number = "<f4" if level == 0 else "<f2"
    color = np.round(np.concatenate([g.sh[:, 0] * SH_C0 + 0.5, g.opacities[:, None]], axis=1) * 255)
    # Degree by degree, and within a degree channel by channel.
    bands = [g.sh[:, d * d : (d + 1) ** 2].transpose(0, 2, 1).reshape(len(g), -1) for d in range(1, g.sh_degree + 1)]
    rest = np.concatenate(bands, axis=1) if bands else np.zeros((len(g), 0))
    if level == 2:
        rest = np.floor((rest + 1.5) / 3 * 255)
    columns = [
        stored,
        g.scales.astype(number),
        g.quaternions.astype(number),
        np.clip(color, 0, 255).astype("u1"),
        rest.astype(("<f4", "<f2", "u1")[level]),
    ]
    rows = np.concatenate([np.ascontiguousarray(c).view("u1").reshape(len(g), -1) for c in columns], axis=1)
    body = np.array(lengths, "<u4").tobytes() + centers.astype("<f4").tobytes() + rows.tobytes()
    buckets = (_BUCKET, len(centers), BLOCK, 12) if level else (0, 0, 0.0, 0)
    header = struct.pack(
        "<IIIIfHxxIIIIH", len(g), len(g), *buckets, 32767 if level else 0, len(body), full, len(lengths), g.sh_degree
    )
    return g, header.ljust(1024, b"\0"), body


# SOG

SOG_COUNT = 37


def webp(pixels: np.ndarray, **options: Any) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "WEBP", **{"lossless": True, "exact": True, "quality": 0, **options})
    return file.getvalue()


def sog_image(rows: np.ndarray) -> bytes:
    """Pixels of the Gaussians in 8 columns, the last row filled up."""
    pixels = np.zeros((-(-len(rows) // 8) * 8, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(rows), : rows.shape[1]] = rows
    return webp(pixels.reshape(-1, 8, 4))


def sog_scene(bands: int = 2) -> tuple[dict[str, Any], dict[str, bytes], dict[str, np.ndarray]]:
    """A meta.json of version 2, its files, and the bytes that are in them."""
    rng = np.random.default_rng(0)
    names = ("means_l", "means_u", "quats", "scales", "sh0")
    raw = {name: rng.integers(0, 256, (SOG_COUNT, 4)).astype(np.uint8) for name in names}
    raw["quats"][:, 3] = 252 + rng.integers(0, 4, SOG_COUNT)
    meta: dict[str, Any] = {
        "version": 2,
        "count": SOG_COUNT,
        "means": {"mins": [-3, -2, 0.5], "maxs": [3, 1, 0.5], "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": np.linspace(-9, 1, 256).tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": np.linspace(-2, 2, 256).tolist(), "files": ["sh0.webp"]},
    }
    files = {f"{name}.webp": sog_image(rows) for name, rows in raw.items()}
    if bands:
        raw["palette"] = rng.integers(0, 256, (5, 64 * (0, 3, 8, 15)[bands], 3)).astype(np.uint8)
        raw["labels"] = rng.integers(0, 300, SOG_COUNT)
        rest = {"count": 300, "bands": bands, "codebook": np.linspace(-1, 1, 256).tolist()}
        meta["shN"] = {**rest, "files": ["centroids.webp", "labels.webp"]}
        files["centroids.webp"] = webp(raw["palette"])
        files["labels.webp"] = sog_image(np.stack([raw["labels"] % 256, raw["labels"] // 256], axis=1))
    return meta, files, raw


def sog_version_1(meta: dict[str, Any]) -> dict[str, Any]:
    """The description of version 1 (ranges in the place of codebooks) of the same files."""
    return {
        "means": {**meta["means"], "shape": [SOG_COUNT, 3], "dtype": "float32"},
        "scales": {"mins": [-9, -8, -7], "maxs": [1, 0, 2], "files": ["scales.webp"]},
        "quats": meta["quats"],
        "sh0": {"mins": [-1, -2, -3, -6], "maxs": [1, 2, 3, 4], "files": ["sh0.webp"]},
        "shN": {"mins": -0.5, "maxs": 1.5, "files": meta["shN"]["files"]},
    }


def zipped(meta: dict[str, Any], files: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr("meta.json", json.dumps(meta))
        for name, data in files.items():
            archive.writestr(name, data)
    return file.getvalue()


def write_sog_folder(folder: Path) -> Path:
    meta, files, _ = sog_scene(3)
    (folder / "meta.json").write_text(json.dumps(meta))
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


# A small file of each


def written(gaussians: Gaussians, suffix: str) -> bytes:
    """Bytes of the file that GSRAIN writes."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"a{suffix}"
        write_gaussians(gaussians, file)
        return file.read_bytes()


def gltf(gaussians: Gaussians, uri: str | None = None) -> bytes:
    """The description of a `.glb` as text, with its buffer as data unless that is a file."""
    data = written(gaussians, ".glb")
    length = struct.unpack_from("<I", data, 12)[0]
    values = json.loads(data[20 : 20 + length])
    values["buffers"][0]["uri"] = uri or "data:;base64," + base64.b64encode(data[28 + length :]).decode()
    return json.dumps(values).encode()


_SMALL = sample_gaussians(7, 1)


def archive(files: dict[str, bytes]) -> bytes:
    """A zip file of files."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archived:
        for name, content in files.items():
            archived.writestr(name, content)
    return buffer.getvalue()


SMALL_FILES: dict[str, tuple[str, Callable[[], bytes]]] = {
    "ply": ("a.ply", lambda: written(_SMALL, ".ply")),
    "ply-sh3": ("a.ply", lambda: written(sample_gaussians(3, 3), ".ply")),
    "compressed-ply": ("a.compressed.ply", lambda: compressed(7, 1, BOUNDS, sh_rows=7)),
    "splat": ("a.splat", lambda: written(_SMALL, ".splat")),
    "spz-1": ("a.spz", lambda: old_spz(_SMALL, 1)),
    "spz-2": ("a.spz", lambda: old_spz(_SMALL, 2)),
    "spz-3": ("a.spz", lambda: old_spz(_SMALL, 3)),
    "spz-4": ("a.spz", lambda: encode_spz(_SMALL)),
    "ksplat-0": ("a.ksplat", lambda: ksplat([sample_gaussians(40, 1), sample_gaussians(9, 2)], 0)[1]),
    "ksplat-1": ("a.ksplat", lambda: ksplat([sample_gaussians(40, 1), sample_gaussians(9, 2)], 1)[1]),
    "ksplat-2": ("a.ksplat", lambda: ksplat([sample_gaussians(40, 1), sample_gaussians(9, 2)], 2)[1]),
    "sog-1": ("a.sog", lambda: zipped(sog_version_1(sog_scene()[0]), sog_scene()[1])),
    "sog-2": ("a.sog", lambda: zipped(*sog_scene()[:2])),
    "gltf": ("a.gltf", lambda: gltf(_SMALL)),
    "zip": ("a.zip", lambda: archive({"b/a.ply": written(_SMALL, ".ply"), "b/about.txt": b"a plant"})),
}
"""Name of a file, and its content; formats below that GSRAIN writes need no row."""
for _suffix in writable_suffixes():
    if all(not file.endswith(_suffix) for file, _ in SMALL_FILES.values()):
        SMALL_FILES[_suffix] = (f"a{_suffix}", partial(written, _SMALL, _suffix))


def write_small(name: str, folder: Path) -> Path:
    file, content = SMALL_FILES[name]
    (folder / file).write_bytes(content())
    return folder / file
