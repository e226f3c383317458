"""Whoever drives or stands ahead in the lane, as far as a planner needs to know."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Lead:
    """What is ahead in the lane at a moment."""

    gap_m: float
    """From the front bumper to the nearest of it, along the route; 0 or less where they touch."""
    speed_m_s: float
    """Its own speed along the route; below 0 it comes nearer by itself."""
