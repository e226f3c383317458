import numpy as np
import pytest

from gsrain_engine.disdrometer.instruments import (
    PARSIVEL_AREA_M2,
    PARSIVEL_DIAMETER_EDGES_MM,
    PARSIVEL_VELOCITY_EDGES_M_S,
    Order,
    arrange_spectrum,
)
from parsivel_text import DRY, RAIN_MM_H, rain


def arranged(counts: np.ndarray, written: Order, reported_mm_h: float, records: int = 1) -> tuple[np.ndarray, Order]:
    return arrange_spectrum(
        np.tile(counts.ravel().astype(float), (records, 1)),
        written,
        diameter_edges_mm=PARSIVEL_DIAMETER_EDGES_MM,
        velocity_edges_m_s=PARSIVEL_VELOCITY_EDGES_M_S,
        area_m2=PARSIVEL_AREA_M2,
        seconds=np.full(records, 60.0),
        reported_mm_h=np.full(records, reported_mm_h),
    )


@pytest.mark.parametrize("reported", [RAIN_MM_H, 0.0, np.nan])
@pytest.mark.parametrize("written", ["velocities first", "diameters first"])
def test_the_order_is_found_whatever_is_expected(reported: float, written: Order):
    for counts, order in ((rain(), "diameters first"), (rain().T, "velocities first")):
        spectra, found = arranged(counts, written, reported)
        np.testing.assert_array_equal(spectra[0], rain())
        assert found == order


@pytest.mark.parametrize("written", ["velocities first", "diameters first"])
def test_without_many_drops_the_expected_order_stands(written: Order):
    assert arranged(DRY, written, 0.0)[1] == written
    for counts in (rain() // 6, rain().T // 6):
        assert 0 < counts.sum() < 50
        assert arranged(counts, written, 0.0)[1] == written


@pytest.mark.parametrize("factor", [0.25, 4.0, 30.0])
def test_a_rate_that_fits_neither_order(factor: float):
    # It proves nothing: the drops' speeds decide.
    for counts, order in ((rain(), "diameters first"), (rain().T, "velocities first")):
        assert arranged(counts, "diameters first", factor * RAIN_MM_H, records=5)[1] == order


@pytest.mark.parametrize("written", ["velocities first", "diameters first"])
def test_the_rate_decides_where_drops_are_slower_than_rain_too(written: Order):
    """1.6 mm at 0.85 m/s: read the other way round they would be smaller, and less rain than was reported."""
    counts = np.zeros_like(rain())
    counts[12, 8] = 400
    middle_mm = 0.5 * (PARSIVEL_DIAMETER_EDGES_MM[12] + PARSIVEL_DIAMETER_EDGES_MM[13])
    reported = 60 * 400 * np.pi / 6 * middle_mm**3 / (1e6 * PARSIVEL_AREA_M2[12])
    for each, order in ((counts, "diameters first"), (counts.T, "velocities first")):
        assert arranged(each, written, float(reported))[1] == order
