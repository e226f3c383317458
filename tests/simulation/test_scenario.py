"""Valid scenarios: each value within bounds, ambiguous names are rejected."""

import msgspec
import pytest

from simulation.small_drive import lead, scenario


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"size_lwh_m": [-4.0, 2.0, 1.5]}, r"> 0.0 - at `\$.road_users\[0\].size_lwh_m\[0\]`"),
        ({"size_lwh_m": [4.0, 0.0, 1.5]}, r"> 0.0 - at `\$.road_users\[0\].size_lwh_m\[1\]`"),
        ({"size_lwh_m": [4.0, 2.0, float("nan")]}, r"at `\$.road_users\[0\].size_lwh_m\[2\]`"),
        ({"behaviour": {"kind": "track", "points": [{"time_s": 1.0, "ahead_m": float("nan")}]}}, "ahead_m`"),
        ({"behaviour": {"kind": "track", "points": [{"time_s": float("inf"), "ahead_m": 1.0}]}}, "time_s`"),
        ({"id": "ego"}, "a road user can't be called 'ego'"),
        ({"id": "background"}, "a road user can't be called 'background'"),
    ],
)
def test_what_no_road_user_can_be_is_named(fields, words):
    with pytest.raises(msgspec.ValidationError, match=words):
        scenario(road_users=[lead(**fields)])
    assert scenario(road_users=[lead(size_lwh_m=[4.0, 2.0, 1.5])]).road_users[0].id == "lead"
