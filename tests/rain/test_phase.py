"""Phase functions of rain and fog (docs/physics/night.md)."""

import numpy as np
import pytest

from benchmarks.phase_functions import MieLight, fog_numbers, rain_numbers
from gsrain_engine.rain.phase import (
    ANGLES,
    NARROW_DEG,
    RATES_MM_H,
    asymmetry,
    fog_phase,
    phase_sums,
    phase_table,
    rain_phase,
    sphere_weights,
)

DEGREES = np.linspace(0, 180, ANGLES)


def test_each_row_has_an_integral_of_4_pi():
    """By a sum over a hundred times finer angles."""
    fine = np.radians(np.linspace(0, 180, 100 * (ANGLES - 1) + 1))
    for row in phase_table():
        values = np.interp(fine, np.radians(DEGREES), row) * 2 * np.pi * np.sin(fine)
        assert np.trapezoid(values, fine) == pytest.approx(4 * np.pi, rel=1e-3)


def test_asymmetry_is_that_of_large_spheres_of_water():
    """Half of the light of rain is diffracted straight ahead, the other half has the geometric g of 0.77."""
    rain, fog = [asymmetry(row) for row in phase_table()[:-1]], asymmetry(fog_phase())
    assert rain == pytest.approx([0.884] * len(RATES_MM_H), abs=0.003)
    assert fog == pytest.approx(0.865, abs=0.01)
    wide = rain_phase(8.5)
    share = sphere_weights() @ wide / (4 * np.pi)
    assert share == pytest.approx(0.5, abs=0.01)
    assert asymmetry(wide) / share == pytest.approx(0.77, abs=0.01)


def test_rain_has_its_rainbows_where_descartes_has_them():
    """At 42 and 51 degrees from the point opposite of the lamp, with the dark band between them."""
    row = rain_phase(8.5)
    primary = DEGREES[np.argmax(np.where((DEGREES > 132) & (DEGREES < 145), row, 0))]
    secondary = DEGREES[np.argmax(np.where((DEGREES > 115) & (DEGREES < 132), row, 0))]
    assert primary == pytest.approx(180 - 41.5, abs=1.5)
    assert secondary == pytest.approx(180 - 51.5, abs=1.5)
    dark = row[(DEGREES > 131) & (DEGREES < 136)].min()
    assert dark < 0.2 * row[(DEGREES > 137) & (DEGREES < 141)].max()


def test_rain_between_the_rates_of_the_table_lies_between_its_rows():
    table, after = phase_table(), DEGREES >= NARROW_DEG
    assert rain_phase(4.0)[after] == pytest.approx(table[1][after])
    assert rain_phase(0.0)[after] == pytest.approx(table[0][after])
    assert rain_phase(140.0)[after] == pytest.approx(table[3][after])
    assert rain_phase(8.0)[after] == pytest.approx(0.5 * (table[1] + table[2])[after])


def test_sums_are_the_integral_over_the_angle():
    sums = phase_sums(np.ones(ANGLES))
    assert sums[[0, 360, 720]] == pytest.approx([0, np.pi / 2, np.pi])


_AT = np.array([3.0, 5.0, 10.0, 30.0, 60.0, 100.0, 125.0, 139.0, 160.0, 175.0])
_AROUND = np.linspace(-0.5, 0.5, 12, endpoint=False) + 1 / 24


@pytest.fixture(scope="module")
def light_of_rain():
    """Diameters in um, other ones than the table was made of, and the light that they scatter."""
    pytest.importorskip("miepython", reason="miepython is missing")
    diameters_um = np.geomspace(160.0, 5500.0, 351)
    return diameters_um, MieLight.of(diameters_um, np.radians(_AT[:, None] + _AROUND))


@pytest.mark.parametrize("row", range(len(RATES_MM_H) + 1))
def test_points_are_within_two_percent_of_miepython(row, light_of_rain):
    """Other sizes and angles than the table was made of, over 1 degree; the primary bow is within 3.5."""
    if row < len(RATES_MM_H):
        diameters_um, light = light_of_rain
        numbers = rain_numbers(diameters_um, RATES_MM_H[row])
    else:
        radii_um = np.linspace(0.3, 44.0, 2501)
        light, numbers = MieLight.of(2 * radii_um, np.radians(_AT[:, None] + _AROUND)), fog_numbers(radii_um)
    expected = light.mean(numbers)
    rings = np.sin(np.radians(_AT[:, None] + _AROUND))
    found = np.interp(_AT[:, None] + _AROUND, DEGREES, phase_table()[row])
    found = (found * rings).sum(axis=1) / rings.sum(axis=1)
    assert np.all(np.abs(found / expected - 1) < np.where(_AT == 139.0, 0.035, 0.02))
