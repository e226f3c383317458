"""Values of options: no NaN, however they are grouped, and errors that name the option as typed."""

import math
from dataclasses import dataclass

import pytest

from app.options import converted_options, reject_non_finite
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.export_settings import ExportSettings


@dataclass
class _Grouped:
    first_s: float
    bounds: tuple[float, float] = (0.0, 1.0)


def test_no_option_takes_nan_however_deep_it_stands():
    for value in (1.0, (1.0, 2.0), [1.0], _Grouped(1.0), "nan", None):
        reject_non_finite(None, value)
    for value in (math.nan, (1.0, math.inf), [-math.inf]):
        with pytest.raises(ValueError, match=r"^Expected a finite number\.$"):
            reject_non_finite(None, value)
    with pytest.raises(ValueError, match=r"^--first-s: Expected a finite number\.$"):
        reject_non_finite(None, _Grouped(math.nan))
    with pytest.raises(ValueError, match=r"^--bounds: Expected a finite number\.$"):
        reject_non_finite(None, _Grouped(1.0, (0.0, math.nan)))


@pytest.mark.parametrize(
    ("values", "kind", "says"),
    [
        ({"intensity_mm_h": -3.0}, RainSettings, "--rain: Expected `float` >= 0.0"),
        ({"exposure_s": 2.0}, RainSettings, "--exposure must be within 0.00001..1 s, got 2.0"),
        ({"haze_count": -1}, RainSettings, "--haze-count must be within 0..200000, got -1"),
        ({"closure": "even"}, RainSettings, "--drop-density: Invalid enum value 'even', expected density, published"),
        ({"output": "a", "passes": ["blue"]}, ExportSettings,
         "--passes: Invalid enum value 'blue', expected alpha, color, depth, labels"),
    ],
)  # fmt: skip
def test_an_error_names_the_option(values, kind, says):
    with pytest.raises(ValueError) as error:
        converted_options(values, kind)
    assert str(error.value) == says
