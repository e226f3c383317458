"""What a person may ask of the built-in street."""

from typing import Annotated

import msgspec
from msgspec import Meta


class StreetParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Size and contents of the street. It runs along +x, with the ego lane on the right (y < 0) and z upwards."""

    seed: Annotated[int, Meta(ge=0, le=2**31 - 1, title="Seed")] = 7
    """Which street: the same seed gives the same bytes."""
    length_m: Annotated[float, Meta(ge=120, le=260, title="Length", extra={"unit": "m"})] = 180.0
    """From the cross street behind the start to the one ahead."""
    behind_m: Annotated[float, Meta(ge=20, le=60, title="Behind the start", extra={"unit": "m"})] = 30.0
    """How much of the length lies behind x = 0."""
    lane_width_m: Annotated[float, Meta(ge=2.8, le=4.0, title="Lane width", extra={"unit": "m"})] = 3.4
    """One lane each way."""
    parking_width_m: Annotated[float, Meta(ge=2.0, le=2.6, title="Parking lane width", extra={"unit": "m"})] = 2.2
    """One parking lane on each side."""
    pavement_width_m: Annotated[float, Meta(ge=2.5, le=5.0, title="Pavement width", extra={"unit": "m"})] = 3.5
    """From kerb to house fronts."""
    tree_spacing_m: Annotated[float, Meta(ge=8, le=60, title="Tree spacing", extra={"unit": "m"})] = 15.0
    """Along each pavement."""
    parked_share: Annotated[float, Meta(ge=0, le=1, title="Parked cars")] = 0.46
    """Share of the parking bays that are taken."""
    sun_azimuth_deg: Annotated[float, Meta(ge=0, le=180, title="Sun azimuth", extra={"unit": "deg"})] = 128.0
    """Counter-clockwise from the driving direction: 90 is from the left, 180 from behind."""
    sun_elevation_deg: Annotated[float, Meta(ge=25, le=75, title="Sun elevation", extra={"unit": "deg"})] = 47.0
    """Above the horizon."""
    ego_speed_m_s: Annotated[float, Meta(ge=0, le=20, title="Ego speed", extra={"unit": "m/s"})] = 10.0
    """The ego vehicle's constant speed."""
    lead_gap_m: Annotated[float, Meta(ge=6, le=60, title="Gap to the lead car", extra={"unit": "m"})] = 18.0
    """From the ego's origin to the middle of the lead car at the start."""

    @property
    def start_x_m(self) -> float:
        """Where the rows of houses begin."""
        return -self.behind_m

    @property
    def end_x_m(self) -> float:
        return self.length_m - self.behind_m

    @property
    def kerb_y_m(self) -> float:
        """Half the width between the kerbs."""
        return self.lane_width_m + self.parking_width_m

    @property
    def front_y_m(self) -> float:
        """Half the width between the house fronts."""
        return self.kerb_y_m + self.pavement_width_m

    @property
    def drive_seconds(self) -> float:
        """How long the ego drives: until 30 m before the end, or 15 s where it stands still."""
        if self.ego_speed_m_s <= 0:
            return 15.0
        return min(60.0, (self.end_x_m - 30.0) / self.ego_speed_m_s)
