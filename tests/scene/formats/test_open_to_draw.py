"""Whatever the format, what its reader makes can be brought into drawing order: else no window could open it."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.scene.formats._common import Format
from gsrain_engine.scene.formats.registry import FORMATS, read_gaussians
from gsrain_engine.scene.lod_order import lod_order
from gsrain_engine.scene.open import load_sorted_scene

from .sample_gaussians import sample_gaussians

FILES = (
    "playbot/playbot_lod3_31k_sh2.ply",
    "playbot/playbot_lod3_31k_sh2.compressed.ply",
    "playbot/playbot_lod3_31k_sh2.sog",
    "playbot/playbot_lod3_31k_sh2.v3.spz",
    "playbot/playbot_lod3_31k_sh2.v4.spz",
    "minimal/minimal.splat",
    "minimal/minimal.ksplat",
    "minimal/minimal-v2.spz",
)


def check_opened(path: Path) -> None:
    (layer,) = load_sorted_scene(str(path)).layers
    read = read_gaussians(path)
    order = lod_order(read)
    for field in fields(read):
        np.testing.assert_array_equal(getattr(layer.gaussians, field.name), getattr(read, field.name)[order])


@pytest.mark.parametrize("file", FILES)
def test_a_real_file_opens_to_be_drawn(file: str, test_data: Path) -> None:
    check_opened(test_data / "scenes" / file)


@pytest.mark.parametrize("row", [row for row in FORMATS if row.write is not None], ids=lambda row: row.suffix)
def test_what_we_write_opens_to_be_drawn(row: Format, tmp_path: Path) -> None:
    assert row.write is not None
    row.write(sample_gaussians(), tmp_path / f"scene{row.suffix}")
    check_opened(tmp_path / f"scene{row.suffix}")
