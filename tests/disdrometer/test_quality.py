from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.disdrometer.filter import QualityControlReport, apply_quality_control
from gsrain_engine.disdrometer.spectra import DropSpectra

NAMES = ["small drops", "margin fallers", "splashes", "fall speed", "few drops"]


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


def removed(report: QualityControlReport) -> dict[str, tuple[float, int]]:
    return {mask.name: (mask.drops, mask.records) for mask in report.masks}


def test_each_mask_takes_its_own():
    # Atlas et al.: 0.1 mm/s at 0.15 mm, 4.16 m/s at 1.05 mm, 9.15 m/s at 5.05 mm.
    dirty = spectra((0.15, 0.45, 1), (1.05, 6.95, 2), (1.05, 1.45, 4), (5.05, 1.05, 8))
    kept, report = apply_quality_control(dirty)
    assert list(removed(report)) == NAMES
    assert removed(report) == {
        "small drops": (1, 0),
        "margin fallers": (2, 0),
        "splashes": (4, 0),
        "fall speed": (8, 0),
        "few drops": (0, 1),
    }
    assert kept.counts.shape[0] == 1 and kept.counts.sum() == 20
    assert (report.drops, report.drops_kept, report.records, report.records_kept) == (35, 20, 2, 1)
    assert dirty.counts.sum() == 35


def test_tolerance_is_a_fraction_of_the_expected_speed():
    # 6.55 m/s is 57 % above 4.16 m/s, 6.75 m/s is 62 %; 1.75 m/s 58 % below, 1.55 m/s 63 %.
    kept, report = apply_quality_control(spectra((1.05, 6.55, 1), (1.05, 6.75, 2), (1.05, 1.75, 4), (1.05, 1.55, 8)))
    assert kept.counts.sum() == 20 + 1 + 4
    assert removed(report)["margin fallers"][0] == 2 and removed(report)["splashes"][0] == 8
    kept, _ = apply_quality_control(spectra((1.05, 6.75, 2)), speed_tolerance=0.7)
    assert kept.counts.sum() == 22


def test_records_with_few_trusted_drops_go():
    kept, report = apply_quality_control(spectra((1.05, 9.95, 100)), fewest_drops=21)
    assert len(kept) == 0
    assert removed(report)["few drops"] == (20, 2)
    assert report.lines[0] == "0 of 120 drops and 0 of 2 records are kept"
    assert report.lines[-1] == "few drops (fewer than 21 drops left in a record): 20 drops, 2 records removed"


def test_without_speeds_the_masks_of_speed_are_left_out_and_named():
    measured = spectra((1.05, 9.95, 5), (0.15, 0.45, 3))
    kept, report = apply_quality_control(
        replace(measured, velocity_edges_m_s=None, counts=measured.counts.sum(axis=2, keepdims=True))
    )
    assert kept.counts.sum() == 25
    assert [mask.name for mask in report.masks if mask.not_applied] == ["margin fallers", "splashes", "fall speed"]
    assert report.lines[3].endswith("not applied, no fall speed is measured")


def test_given_classes():
    classes = np.ones((100, 150), bool)
    classes[20] = False
    kept, report = apply_quality_control(spectra((2.05, 6.95, 7)), classes=classes)
    assert kept.counts.sum() == 20 and removed(report)["classes"] == (7, 0)
    with pytest.raises(ValueError, match="classes has the shape"):
        apply_quality_control(spectra(), classes=classes[:50])


def test_the_report_adds_up():
    rng = np.random.default_rng(3)
    noisy = replace(spectra(), counts=rng.poisson(0.01, (2, 100, 150)).astype(float))
    kept, report = apply_quality_control(noisy)
    assert report.drops - sum(mask.drops for mask in report.masks) == report.drops_kept == kept.counts.sum() > 0
    assert report.records - sum(mask.records for mask in report.masks) == report.records_kept == len(kept)
