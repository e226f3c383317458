"""A scene that can't fit says so before anything of its size is made."""

from types import SimpleNamespace

import numpy as np
import pytest

from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats._common import check_room
from gsrain_engine.scene.formats.registry import write_gaussians
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.gaussians import Gaussians

from .test_compressed_ply import BOUNDS, compressed


def some(count=100):
    f, rng = np.float32, np.random.default_rng(0)
    quaternions = np.tile(np.array([1, 0, 0, 0], f), (count, 1))
    numbers = rng.uniform(0.1, 0.9, (count, 23)).astype(f)
    return Gaussians(numbers[:, :3], numbers[:, 3:6], quaternions, numbers[:, 6], numbers[:, 7:19].reshape(-1, 4, 3))


@pytest.fixture
def free_bytes(monkeypatch):
    def only(count):
        memory = SimpleNamespace(available=count)
        monkeypatch.setattr("gsrain_engine.scene.formats._common.psutil.virtual_memory", lambda: memory)

    return only


@pytest.mark.parametrize(("suffix", "harmonics"), [(".ply", 4), (".splat", 1), (".spz", 4)])
def test_every_format_looks_before_it_reads(tmp_path, free_bytes, suffix, harmonics):
    path = tmp_path / f"scene{suffix}"
    write_gaussians(some(), path)
    read_scene(path)
    free_bytes(1000)
    with pytest.raises(SceneFormatError, match=r"100 Gaussians need 0.0 GB of memory .*, 0.0 GB are free"):
        read_scene(path)
    needed = 1.6 * 4 * 100 * (11 + 3 * harmonics)
    free_bytes(needed - 1)
    with pytest.raises(SceneFormatError):
        read_scene(path)
    free_bytes(needed)
    assert read_scene(path).layers[0].gaussians.sh.shape[1] == harmonics


def test_a_compressed_ply_with_harmonics_has_room_for_the_third_degree(tmp_path, free_bytes):
    """Its header does not yet say how many of them there are."""
    (tmp_path / "a.ply").write_bytes(compressed(257, 2, BOUNDS[:6], sh_rows=257))
    needed = 1.6 * 4 * 257 * (11 + 48)
    free_bytes(needed)
    assert len(read_scene(tmp_path / "a.ply").layers[0].gaussians) == 257
    free_bytes(needed - 1)
    with pytest.raises(SceneFormatError, match="257 Gaussians need"):
        read_scene(tmp_path / "a.ply")


def test_what_just_fits_is_opened_and_big_scenes_are_announced(tmp_path, free_bytes, caplog):
    caplog.set_level("INFO", logger="gsrain")
    needed = 1.6 * 236 * 1_000_000
    free_bytes(needed)
    check_room(tmp_path / "big.ply", 1_000_000, 16)
    assert caplog.messages == ["big.ply: 1,000,000 Gaussians, 0.2 GB"]
    free_bytes(needed - 1)
    with pytest.raises(SceneFormatError, match=r"1,000,000 Gaussians need 0.4 GB"):
        check_room(tmp_path / "big.ply", 1_000_000, 16)
