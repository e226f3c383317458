"""Colours of what becomes of a pixel when it is looked for in another view: of the picture, and of its legend."""

from gsrain_engine.appearance.matching.correspondence import Outcome

COLORS: dict[Outcome, tuple[float, float, float]] = {
    Outcome.MATCHED: (0.25, 0.8, 0.45),
    Outcome.HIDDEN: (0.9, 0.25, 0.25),
    Outcome.EDGE: (0.95, 0.75, 0.2),
    Outcome.MOVING: (0.65, 0.4, 0.95),
    Outcome.UNKNOWN: (0.55, 0.57, 0.62),
    Outcome.OUTSIDE: (0.0, 0.0, 0.0),
}
"""Display colours of 0..1, in the order of the legend."""
