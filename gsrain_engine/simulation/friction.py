"""Friction of tires on wet roads by speed and depth of the water: braking, cornering and hydroplaning."""

import math

from ..rain.air import GRAVITY_M_S2
from ..rain.simulation import RainSimulation
from ..water.films import WaterFilms
from ..water.spray import displaced_mm

TIRE_KPA = 220.0
"""Inflation pressure of a passenger car's tires."""

_DRY, _DRY_PER_KM_H = 0.9125, 0.00125  # 0.85 at 50, 0.80 at 90, 0.75 at 130 km/h: Bosch's table for new tires
_WET_SHARE = 0.765  # of the dry coefficient that a film of 0.2 mm leaves at 50 km/h (Bosch)
_THIN_MM = 0.05  # film that has nearly its whole effect; ours: Kulakowski and Harwood (1990) find it from 0.025 to 0.23
FLOATING = 0.05
"""Coefficient of a tire that floats: drag of the water alone (Horne and Dreher 1963)."""

_TEST_KPA = 165.0  # of the tires behind the equation of hydroplaning: 24 psi
_LEAST_MM = 0.01
_DEEP_MM = 2.4
_MM_PER_INCH, _KM_H_PER_MPH = 25.4, 1.609344
_TEXTURE_IN = 0.5 / _MM_PER_INCH


def hydroplaning_speed_m_s(film_mm: float, tire_kpa: float = TIRE_KPA) -> float:
    """Speed at which a tire floats on a film that stands so deep over the road's texture; infinite without water.

    26.04 h^-0.259 mph (h in inches) up to 2.4 mm, above 3.09 max(10.409 h^-0.06 + 3.507, (28.952 h^-0.06 - 7.817)
    MTD^0.14) (Gallaway et al. 1979 and Agrawal and Henry 1977, as joined by Anderson et al. 1998, PAVDRN, NCHRP web
    document 16), for 165 kPa; by the pressure with its root, as 6.36 sqrt(p) km/h in deep water (Horne and Dreher
    1963, NASA TN D-2056). The coefficients were not compared with a copy.
    """
    if film_mm <= 0:
        return math.inf
    inches = max(film_mm, _LEAST_MM) / _MM_PER_INCH
    if film_mm < _DEEP_MM:
        mph = 26.04 * inches**-0.259
    else:
        thin = inches**-0.06
        mph = 3.09 * max(10.409 * thin + 3.507, (28.952 * thin - 7.817) * _TEXTURE_IN**0.14)
    return mph * _KM_H_PER_MPH / 3.6 * math.sqrt(tire_kpa / _TEST_KPA)


def friction_coefficient(speed_m_s: float, film_mm: float, tire_kpa: float = TIRE_KPA) -> float:
    """Largest friction coefficient of a rolling tire on asphalt; `film_mm` is the water over the road's texture.

    mu = mu_dry(V) w(h) (1 - (V / V_h)^2), at least `FLOATING`: water between rubber and stones leaves the share w, and
    the pressure of what a tire can't displace carries the rest of the load, all of it at V_h (Horne and Dreher 1963).
    Within 0.05 of the span of new and worn tires in Bosch's Automotive Handbook.
    """
    dry = _DRY - _DRY_PER_KM_H * 3.6 * speed_m_s
    thin = _WET_SHARE + (1 - _WET_SHARE) * math.exp(-4 * film_mm / _THIN_MM)
    carried = (speed_m_s / hydroplaning_speed_m_s(film_mm, tire_kpa)) ** 2
    return max(dry * thin * (1 - carried), FLOATING)


class RoadGrip:
    """Acceleration that tires can transmit in a drive, by speed and time. Without it vehicles have their own limits."""

    def __init__(self, rainfall: RainSimulation) -> None:
        """Use the water films of a rain; no map of dips, which traffic empties."""
        self._films = WaterFilms.of(rainfall)

    def acceleration_m_s2(self, speed_m_s: float, time_s: float) -> float:
        """Largest acceleration in any direction at a speed and a time of the scene: mu g."""
        film_mm = self._films.at(time_s).film_mm
        return GRAVITY_M_S2 * friction_coefficient(speed_m_s, displaced_mm(film_mm) if film_mm > 0 else 0.0)
