"""Names that the reader and the writer of OpenSCENARIO files agree on."""

EGO = "Ego"
"""The ego vehicle."""
PROPERTY = "gsrain."
"""Begins the names of properties that only concern us."""
OWN_FIELDS = (
    "name", "scene", "rig", "start_s", "ahead_m", "left_m", "turned_deg", "step_s", "leave_m", "picture_width_px",
)  # fmt: skip
"""Fields of a scenario that OpenSCENARIO has no word for."""
LANE_M = 3.5
"""Width of a lane: that of the road that is written beside a scenario, and of lanes in files that are read."""
