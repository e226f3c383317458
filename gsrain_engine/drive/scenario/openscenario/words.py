"""Enumerated words of OpenSCENARIO; scenariogeneration declares them as another type than its own classes take."""

from typing import Any

from scenariogeneration import xosc

words: Any = xosc
"""`words.Rule.lessOrEqual`, `words.PrecipitationType.rain`, ..."""
