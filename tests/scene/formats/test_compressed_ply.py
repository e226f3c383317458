"""SuperSplat's compressed PLY."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.ply import read_ply
from gsrain_engine.scene.gaussians import SH_C0, Gaussians

NAME = "scenes/playbot/playbot_lod3_31k_sh2"
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


def test_bits_are_where_they_belong(tmp_path: Path) -> None:
    (tmp_path / "a.compressed.ply").write_bytes(compressed(257, 2, BOUNDS[:6], sh_rows=257))
    gaussians = read_ply(tmp_path / "a.compressed.ply")
    assert len(gaussians) == 257
    middle = [2 * 1024 / 2047 - 1, 2 * 512 / 1023 - 1, 2 * 1024 / 2047 - 1]
    np.testing.assert_allclose(gaussians.means[256], middle, atol=1e-6)
    np.testing.assert_allclose(gaussians.scales[0], np.exp([1, -1, -1]), rtol=1e-6)
    np.testing.assert_allclose(gaussians.quaternions[0], [0.0007, 0.0007, 1, 0.0007], atol=1e-5)
    np.testing.assert_allclose(gaussians.sh[0, 0] * SH_C0 + 0.5, [0.2, 0.4, 1], atol=1e-6)
    assert gaussians.opacities[0] == pytest.approx(0.8)
    np.testing.assert_allclose(gaussians.sh[0, 1:, 0], [-4, 4, 4 / 256], atol=1e-6)


def test_colours_may_have_bounds_outside_0_to_1(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(compressed(1, 1, BOUNDS))
    np.testing.assert_allclose(read_ply(tmp_path / "a.ply").sh[0, 0] * SH_C0 + 0.5, [-0.6, -0.2, 1], atol=1e-6)


def test_a_trained_scene_agrees_with_its_ply(test_data: Path) -> None:
    original, other = read_ply(test_data / f"{NAME}.ply"), read_ply(test_data / f"{NAME}.compressed.ply")
    assert len(other) == len(original)

    def features(g: Gaussians) -> np.ndarray:
        return np.concatenate([g.means * 100, np.log(g.scales), g.opacities[:, None], g.sh[:, 0]], axis=1)

    a = original.take(cKDTree(features(original)).query(features(other))[1])

    def most(errors: np.ndarray) -> float:
        return float(np.quantile(errors, 0.98))

    assert most(np.abs(a.means - other.means)) < 3e-4
    assert most(np.abs(np.log(a.scales / other.scales))) < 0.01
    assert most(np.abs(a.opacities - other.opacities)) < 0.004
    assert most(1 - np.abs((a.quaternions * other.quaternions).sum(1))) < 1e-5
    assert most(np.abs(a.sh[:, 0] - other.sh[:, 0])) < 0.03
    assert most(np.abs(a.sh[:, 1:] - other.sh[:, 1:])) < 1 / 32


WRONG = {
    "chunks": (compressed(257, 1, BOUNDS), "257 Gaussians need 2 chunks, the header lists 1"),
    "bounds": (compressed(1, 1, BOUNDS[:2]), "element 'chunk' of a compressed PLY lacks min_z, max_z, min_scale_x"),
    "words": (compressed(1, 1, BOUNDS).replace(b"packed_scale", b"packed_scald"), "lacks packed_scale"),
    "word types": (
        compressed(1, 1, BOUNDS).replace(b"uint packed_scale", b"int packed_scale"),
        "must be uint32, not int32",
    ),
    "sh types": (compressed(9, 1, BOUNDS, 9).replace(b"uchar f_rest_3", b"char f_rest_3"), "must be uint8, not int8"),
    "sh columns": (compressed(9, 1, BOUNDS, sh_rows=9, sh_columns=12), "9 rows of 12 f_rest_*: expected 9 rows"),
    "sh rows": (compressed(9, 1, BOUNDS, sh_rows=8), "8 rows of 9 f_rest_*: expected 9 rows"),
    "cut off": (compressed(9, 1, BOUNDS)[:-1], "cut off or its counts are wrong"),
    "terabytes": (compressed(9, 1, BOUNDS).replace(b"vertex 9", b"vertex 99999999999"), "cut off or its counts"),
}


@pytest.mark.parametrize("name", WRONG)
def test_contradictions_are_named(name: str, tmp_path: Path) -> None:
    data, message = WRONG[name]
    (tmp_path / "a.ply").write_bytes(data)
    with pytest.raises(SceneFormatError, match=re.escape(message)):
        read_ply(tmp_path / "a.ply")


@pytest.mark.parametrize("bad", [np.nan, np.inf, 3e38])
def test_bounds_that_are_not_finite_are_refused(bad: float, tmp_path: Path) -> None:
    data = compressed(4, 1, BOUNDS)
    start = data.index(b"end_header\n") + len(b"end_header\n")
    for value in (0, 6):  # min_x, min_scale_x
        edited = bytearray(data)
        edited[start + 4 * value : start + 4 * value + 8] = np.array([bad, bad], "<f4").tobytes()
        (tmp_path / "a.ply").write_bytes(edited)
        if value == 0 and bad == 3e38:
            assert np.isfinite(read_ply(tmp_path / "a.ply").means).all()
        else:
            with pytest.raises(SceneFormatError, match=r"4 of 4 Gaussians have a .* not a finite number"):
                read_ply(tmp_path / "a.ply")
