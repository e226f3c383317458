import numpy as np
import pytest

from gsrain_engine.recolor.result import read_recolored, write_recolored
from gsrain_engine.scene.files import SceneFormatError


def test_recolored_files_go_and_come_back_with_any_name(tmp_path):
    sh = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    names = ["layers/../odd name", "actors/käfer", "layers/names"]
    write_recolored(tmp_path / "sub" / "a.npz", {name: sh + i for i, name in enumerate(names)})
    back = read_recolored(tmp_path / "sub" / "a.npz")
    assert list(back) == names
    np.testing.assert_array_equal(back["layers/names"], sh + 2)
    assert [each.name for each in (tmp_path / "sub").iterdir()] == ["a.npz"]


@pytest.mark.parametrize("content", [b"", b"no zip at all", b"PK\x03\x04 truncated"])
def test_other_files_are_refused_with_their_name(tmp_path, content):
    path = tmp_path / "bad.npz"
    path.write_bytes(content)
    with pytest.raises(SceneFormatError, match=r"bad\.npz: not a file of recolored Gaussians"):
        read_recolored(path)


def test_wrong_arrays_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", version=np.array(1), names=np.array(["layers/x"]), sh_0=np.zeros(3))
    with pytest.raises(SceneFormatError, match="expected float32"):
        read_recolored(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", version=np.array(9), names=np.array(["layers/x"]))
    with pytest.raises(SceneFormatError, match="version 9 is newer"):
        read_recolored(tmp_path / "b.npz")
