"""Quality control: each mask takes its own drops, and the report adds up."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.disdrometer.filter import apply_quality_control
from gsrain_engine.disdrometer.spectra import DropSpectra


def spectra(*drops: tuple[float, float, int]) -> DropSpectra:
    """One record with so many drops of each diameter and speed, and 20 good ones of 1.05 mm at 4.5 m/s; a dry one."""
    counts = np.zeros((2, 100, 150))
    for diameter, speed, count in ((1.05, 4.55, 20), *drops):
        counts[0, int(diameter / 0.1), int(speed / 0.1)] += count
    return DropSpectra(
        instrument="test",
        times=np.array(["2018-10-29T00:00", "2018-10-29T00:01"], "M8[ms]"),
        seconds=np.full(2, 60.0),
        diameter_edges_mm=0.1 * np.arange(101),
        velocity_edges_m_s=0.1 * np.arange(151),
        counts=counts,
        area_m2=np.full(100, 0.005),
        reported_mm_h=np.full(2, np.nan),
    )


# Atlas et al.: 0.1 mm/s at 0.15 mm, 4.16 m/s at 1.05 mm, 9.15 m/s at 5.05 mm.
DIRT = (0.15, 0.45, 1), (1.05, 6.95, 2), (1.05, 1.45, 4), (5.05, 1.05, 8)


@pytest.mark.parametrize(
    ("dirt", "options", "removed"),
    [
        (DIRT, {}, {"small drops": 1, "margin fallers": 2, "splashes": 4, "fall speed": 8, "few drops": 0}),
        # 6.55 m/s is 57 % above 4.16 m/s, 6.75 m/s is 62 %; 1.75 m/s 58 % below, 1.55 m/s 63 %.
        (((1.05, 6.55, 1), (1.05, 6.75, 2), (1.05, 1.75, 4), (1.05, 1.55, 8)), {},
         {"margin fallers": 2, "splashes": 8}),
        (((1.05, 6.75, 2),), {"speed_tolerance": 0.7}, {"margin fallers": 0}),
        (((1.05, 9.95, 100),), {"fewest_drops": 21}, {"margin fallers": 100, "few drops": 20}),
    ],
)  # fmt: skip
def test_each_mask_takes_its_own(dirt, options, removed):
    dirty = spectra(*dirt)
    trusted, report = apply_quality_control(dirty, **options)
    found = {mask.name: mask for mask in report.masks}
    assert {name: found[name].drops for name in removed} == removed
    assert report.drops == dirty.counts.sum() == 20 + sum(count for *_, count in dirt)
    assert report.drops - sum(mask.drops for mask in report.masks) == report.drops_kept == trusted.counts.sum()
    assert report.records - sum(mask.records for mask in report.masks) == report.records_kept == len(trusted)
    assert all(f"{mask.name} ({mask.rule}): {mask.drops:.0f} drops" in "\n".join(report.lines) for mask in report.masks)


def test_without_speeds_the_masks_of_speed_are_left_out_and_named():
    measured = spectra((1.05, 9.95, 5), (0.15, 0.45, 3))
    flat = replace(measured, velocity_edges_m_s=None, counts=measured.counts.sum(axis=2, keepdims=True))
    trusted, report = apply_quality_control(flat)
    assert trusted.counts.sum() == 25
    assert [mask.name for mask in report.masks if mask.not_applied] == ["margin fallers", "splashes", "fall speed"]
    assert "not applied" in report.lines[3]
