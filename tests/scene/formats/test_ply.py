"""3DGS PLY files: what is written comes back, and what others write is understood or refused in one line."""

import re
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.ply import read_ply, write_ply
from gsrain_engine.scene.gaussians import Gaussians

from .sample_gaussians import assert_equal, sample_gaussians


def columns_of(path: Path) -> tuple[list[str], np.ndarray]:
    """Property names and values of a PLY of floats, read without our reader."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    names = [line.split()[2].decode() for line in header.splitlines() if line.startswith(b"property float")]
    return names, np.frombuffer(body, "<f4").reshape(-1, len(names))


def write_columns(path: Path, names: list[str], values: np.ndarray, kind: str = "float", order: str = "<") -> None:
    """A PLY with these columns, written without our writer."""
    dtype = {"float": "f4", "double": "f8"}[kind]
    endian = {"<": "little", ">": "big"}[order]
    lines = [f"format binary_{endian}_endian 1.0", "comment made by a test", f"element vertex {len(values)}"]
    lines += [f"property {kind} {name}" for name in names]
    text = "\n".join(["ply", *lines, "end_header", ""])
    path.write_bytes(text.encode() + values.astype(order + dtype).tobytes())


@pytest.fixture
def ply(tmp_path: Path) -> Path:
    write_ply(sample_gaussians(), tmp_path / "scene.ply")
    return tmp_path / "scene.ply"


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_what_is_written_comes_back(degree: int, tmp_path: Path) -> None:
    gaussians = sample_gaussians(5000, degree)  # several pieces of rows
    write_ply(gaussians, tmp_path / "scene.ply")
    assert_equal(read_ply(tmp_path / "scene.ply"), gaussians)


def test_the_written_layout_is_that_of_3dgs(ply: Path, test_data: Path) -> None:
    theirs = re.findall(rb"property \w+ (\w+)", (test_data / "scenes/pc_short.ply").read_bytes()[:3000])
    names, values = columns_of(ply)
    assert names == [name.decode() for name in theirs]
    gaussians = sample_gaussians()
    np.testing.assert_array_equal(values[:, names.index("f_rest_15")], gaussians.sh[:, 1, 1])
    np.testing.assert_allclose(values[:, names.index("scale_2")], np.log(gaussians.scales[:, 2]), rtol=1e-6)


def test_the_same_gaussians_make_the_same_bytes(ply: Path, tmp_path: Path) -> None:
    write_ply(sample_gaussians(), tmp_path / "again.ply")
    assert (tmp_path / "again.ply").read_bytes() == ply.read_bytes()


def test_extreme_opacities_and_scales_survive(tmp_path: Path) -> None:
    some = sample_gaussians(3, 0)
    opacities = np.array([0, 1, 0.25], np.float32)
    scales = np.array([[0, 0, 0], [1e-20, 1e10, 1], [1, 1, 1]], np.float32)
    write_ply(Gaussians(some.means, scales, some.quaternions, opacities, some.sh), tmp_path / "a.ply")
    read = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.opacities[:2], [0, 1])
    np.testing.assert_allclose(read.scales, scales, rtol=1e-5, atol=1e-30)


def test_no_gaussians_at_all(tmp_path: Path) -> None:
    write_ply(Gaussians.empty(2), tmp_path / "none.ply")
    assert read_ply(tmp_path / "none.ply").sh.shape == (0, 9, 3)


def test_properties_in_any_order_of_any_type_and_either_byte_order(ply: Path, tmp_path: Path) -> None:
    names, values = columns_of(ply)
    shuffled = np.random.default_rng(3).permutation(len(names))
    for kind, order in [("float", "<"), ("float", ">"), ("double", "<"), ("double", ">")]:
        write_columns(tmp_path / "b.ply", [names[i] for i in shuffled], values[:, shuffled], kind, order)
        assert_equal(read_ply(tmp_path / "b.ply"), sample_gaussians())


def test_normals_may_be_missing_and_extra_properties_are_passed_over(ply: Path, tmp_path: Path) -> None:
    names, values = columns_of(ply)
    kept = [i for i, name in enumerate(names) if name not in ("nx", "ny", "nz")]
    extra = np.full((len(values), 1), np.nan)
    write_columns(tmp_path / "c.ply", ["confidence", *(names[i] for i in kept)], np.hstack([extra, values[:, kept]]))
    assert_equal(read_ply(tmp_path / "c.ply"), sample_gaussians())


def test_other_elements_are_passed_over(ply: Path, tmp_path: Path) -> None:
    header, body = ply.read_bytes().split(b"element vertex", 1)
    before = b"element camera 2\nproperty double focal\nproperty uchar kind\n"
    vertex, rows = body.split(b"end_header\n", 1)
    after = b"element face 1\nproperty list uchar int vertex_indices\n"
    data = header + before + b"element vertex" + vertex + after + b"end_header\n"
    (tmp_path / "d.ply").write_bytes(data + bytes(18) + rows + bytes([3, *range(12)]))
    assert_equal(read_ply(tmp_path / "d.ply"), sample_gaussians())


def test_windows_line_ends(ply: Path, tmp_path: Path) -> None:
    header, body = ply.read_bytes().split(b"end_header\n", 1)
    (tmp_path / "e.ply").write_bytes((header + b"end_header\n").replace(b"\n", b"\r\n") + body)
    assert_equal(read_ply(tmp_path / "e.ply"), sample_gaussians())


def test_quaternions_are_normalized_and_opacities_activated(test_data: Path) -> None:
    path = test_data / "scenes/pc_short.ply"
    header, body = path.read_bytes().split(b"end_header\n", 1)
    names = [line.split()[2].decode() for line in header.splitlines() if line.startswith(b"property float")]
    values = np.frombuffer(body, "<f4", 100 * len(names)).reshape(100, -1)
    gaussians = read_ply(path)
    lengths = np.linalg.norm(values[:, [names.index(f"rot_{i}") for i in range(4)]], axis=1)
    assert lengths.min() < 0.8 and lengths.max() > 1.2
    np.testing.assert_allclose(np.linalg.norm(gaussians.quaternions, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(gaussians.opacities, 1 / (1 + np.exp(-values[:, names.index("opacity")])), rtol=1e-5)
    assert gaussians.sh.shape == (100, 16, 3)


def test_sh_degree_2_has_24_rest_properties(test_data: Path) -> None:
    gaussians = read_ply(test_data / "scenes/playbot/playbot_lod3_31k_sh2.ply")
    names, values = columns_of(test_data / "scenes/playbot/playbot_lod3_31k_sh2.ply")
    assert gaussians.sh.shape == (31000, 9, 3)
    np.testing.assert_array_equal(gaussians.sh[:, 8, 2], values[:, names.index("f_rest_23")])
    np.testing.assert_array_equal(gaussians.sh[:, 1, 1], values[:, names.index("f_rest_8")])


def write_text(path: Path, ply: Path, rows: slice = slice(None), before: str = "") -> Path:
    """The same PLY as text, written without our writer; `before` are lines of an element `note` of one number."""
    names, values = columns_of(ply)
    note = f"element note {before.count(chr(10))}\nproperty int number\n" * bool(before)
    properties = "".join(f"property float {name}\n" for name in names)
    lines = "".join(" ".join(repr(float(value)) for value in row) + "\n" for row in values[rows])
    head = f"ply\nformat ascii 1.0\n{note}element vertex {len(values)}\n{properties}end_header\n"
    path.write_text(head + before + lines)
    return path


@pytest.mark.parametrize("degree", [0, 3])
def test_text_is_read(degree: int, tmp_path: Path) -> None:
    gaussians = sample_gaussians(2500, degree)  # several pieces of lines
    write_ply(gaussians, tmp_path / "scene.ply")
    assert_equal(read_ply(write_text(tmp_path / "text.ply", tmp_path / "scene.ply", before="7\n8\n")), gaussians)
    whole = (tmp_path / "text.ply").read_bytes()
    (tmp_path / "text.ply").write_bytes(whole.replace(b"\n", b"\r\n").removesuffix(b"\r\n"))
    assert_equal(read_ply(tmp_path / "text.ply"), gaussians)


def test_bad_text_is_named(ply: Path, tmp_path: Path) -> None:
    cut = write_text(tmp_path / "cut.ply", ply, slice(-20))
    with pytest.raises(SceneFormatError, match="vertex 280: 0 numbers in its line, its header lists 62"):
        read_ply(cut)
    text = write_text(tmp_path / "word.ply", ply)
    text.write_bytes(text.read_bytes().replace(b"end_header\n", b"end_header\nhalf ", 1))
    with pytest.raises(SceneFormatError, match="vertex 0: 63 numbers in its line"):
        read_ply(text)
    head, lines = text.read_bytes().split(b"half ", 1)
    text.write_bytes(head + b"half " + lines.split(b" ", 1)[1])
    with pytest.raises(SceneFormatError, match="vertices 0 to 299: a word is no number") as error:
        read_ply(text)
    assert "convert" not in str(error.value)
    text.write_bytes(head.replace(b"vertex 300", b"vertex 300000000") + lines)
    with pytest.raises(SceneFormatError, match="at least .* bytes; the file has .* counts are wrong"):
        read_ply(text)


HEADER_EDITS = {
    "not a PLY": (b"ply\n", b"plx\n", "start with the line 'ply'"),
    "text": (b"binary_little_endian", b"ascii", "vertex 0: "),
    "unknown format": (b"binary_little_endian", b"binary_middle_endian", "binary_little_endian 1.0"),
    "no end": (b"end_header", b"end_headed", "no line 'end_header'"),
    "no vertices": (b"element vertex", b"element vortex", "an element 'vertex', not vortex"),
    "terabytes": (b"vertex 300", b"vertex 300000000000", "cut off or its counts are wrong"),
    "endless number": (b"vertex 300", b"vertex " + b"9" * 5000, "cut off or its counts are wrong"),
    "one too many": (b"vertex 300", b"vertex 301", "takes 76176 bytes; the file has 75928"),
    "negative": (b"vertex 300", b"vertex -1", "makes no sense: 'element vertex -1'"),
    "unknown type": (b"property float x", b"property quad x", "makes no sense: 'property quad x'"),
    "list": (b"property float nx", b"property list uchar int nx", "has a list property"),
    "twice": (b"property float nx", b"property float x", "property 'x' twice"),
    "missing": (b"property float opacity", b"property float opalcity", "no property opacity"),
    "44 harmonics": (b"property float f_rest_44", b"property float e_rest_44", "44 properties f_rest_*: expected 0, 9"),
    "gap": (b"property float f_rest_44", b"property float f_rest_45", "counted from f_rest_0"),
}


@pytest.mark.parametrize("edit", HEADER_EDITS)
def test_bad_headers_are_named(edit: str, ply: Path) -> None:
    old, new, message = HEADER_EDITS[edit]
    ply.write_bytes(ply.read_bytes().replace(old, new, 1))
    with pytest.raises(SceneFormatError, match=re.escape(message)) as error:
        read_ply(ply)
    assert str(error.value).startswith(f"{ply}: ")
    assert "\n" not in str(error.value)


VALUES = {
    "x": (np.nan, "a mean that is not a finite number"),
    "f_rest_44": (np.inf, "a color that is not a finite number"),
    "scale_1": (100, "a scale that is not a finite number"),
    "scale_2": (-np.inf, "a logarithm of a scale that is not a finite number"),
    "opacity": (np.inf, "a logit of an opacity that is not a finite number"),
    "rot_0": (-np.inf, "a quaternion that is not a finite number"),
    "rot_3": (1e30, "a quaternion too long to be normalized"),
}


@pytest.mark.parametrize("name", VALUES)
def test_values_that_no_gaussian_has_are_counted(name: str, ply: Path) -> None:
    names, values = columns_of(ply)
    values = values.copy()
    bad, message = VALUES[name]
    values[[7, 211], names.index(name)] = bad
    write_columns(ply, names, values)
    with pytest.raises(SceneFormatError, match=f"2 of 300 Gaussians have {message}, the first is number 7"):
        read_ply(ply)


def test_both_infinities_at_once_are_counted_without_a_warning(ply: Path) -> None:
    names, values = columns_of(ply)
    values = values.copy()
    values[3, names.index("x")], values[4, names.index("x")] = np.inf, -np.inf
    write_columns(ply, names, values)
    with pytest.raises(SceneFormatError, match="2 of 300 Gaussians have a mean"):
        read_ply(ply)


def test_zero_quaternions_are_refused(ply: Path) -> None:
    names, values = columns_of(ply)
    values = values.copy()
    values[5, [names.index(f"rot_{i}") for i in range(4)]] = 0
    write_columns(ply, names, values)
    with pytest.raises(SceneFormatError, match="1 of 300 Gaussians have a zero quaternion, the first is number 5"):
        read_ply(ply)
