"""A scenario's rain in the words of OpenSCENARIO."""

from typing import Any

import numpy as np
from scenariogeneration import xosc

from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rain_state import rain_state
from gsrain_engine.rain.wetness import SOAKING_DEPTH_MM, water_depth_mm

from .words import words


def environment_of(rain: Rain) -> xosc.EnvironmentAction:
    """Return the action that makes the weather: precipitation in mm/h, fog of the rain's visual range, wind, wetness.

    The visual range is the meteorological optical range ln(20) / beta of the rain's own extinction. Friction stays 1:
    no vehicle here slips.
    """
    intensity = rain.intensity_mm_h
    kind = words.PrecipitationType.rain if intensity > 0 else words.PrecipitationType.dry
    fog = wind = cloud = None
    if intensity > 0:
        cloud = words.FractionalCloudCover.eightOktas
        visibility = rain_state(rain, load_calibration(rain.calibration)).visibility_m
        fog = None if np.isinf(visibility) else words.Fog(round(visibility, 1))
    x, y = rain.wind_m_s
    if x or y:
        wind = xosc.Wind(float(np.arctan2(y, x)) % (2 * np.pi), float(np.hypot(x, y)))
    weather = xosc.Weather(cloud, fog=fog, precipitation=xosc.Precipitation(kind, intensity), wind=wind)
    road = xosc.RoadCondition(1.0, wetness=_wetness(intensity))
    return xosc.EnvironmentAction(xosc.Environment("weather", weather=weather, roadcondition=road))


def _wetness(intensity_mm_h: float) -> Any:
    if intensity_mm_h == 0:
        return words.Wetness.dry
    soaks = water_depth_mm(intensity_mm_h) >= SOAKING_DEPTH_MM
    return words.Wetness.wetWithPuddles if soaks else words.Wetness.moist
