"""Keeps track of everybody who was seen in the lane ahead, and says who leads."""

from collections.abc import Sequence
from typing import NamedTuple

from .lead import Lead
from .lead_track import LEAST_CONFIDENCE, LeadTrack
from .sighting import Sighting

_DOUBLE_M = 4.0
"""Boxes of one thing (car and truck, the whole and its cab) lie so near to each other: they begin nothing new."""


class WatchedLead(NamedTuple):
    """Who leads, and what it was last seen as."""

    lead: Lead
    track: LeadTrack
    sighting: Sighting | None
    """Of this moment; none where it was missed."""


class LeadWatch:
    """Remembers from moment to moment. The same sightings give the same answer."""

    def __init__(self) -> None:
        self._tracks: list[tuple[LeadTrack, Sighting | None]] = []

    def look(self, seen: Sequence[Sighting], front_along_m: float, speed_m_s: float, dt_s: float) -> WatchedLead | None:
        """Take in what is seen a time after the last look; `front_along_m` is the front bumper's place on the route.

        Returns the nearest one that is sure to be there; none where the lane is free.
        """
        left = list(seen)
        tracks: list[tuple[LeadTrack, Sighting | None]] = []
        for track, _ in sorted(self._tracks, key=lambda each: each[0].along_m):
            track = track.later(dt_s)
            sighting = _nearest(track, left, front_along_m)
            if sighting is not None:
                left.remove(sighting)
                track = track.seen_again(sighting, front_along_m)
            if track.believed(front_along_m):
                tracks.append((track, sighting))
        for sighting in sorted(left, key=lambda each: -each.detection.confidence):
            place = front_along_m + sighting.gap_m
            new = sighting.detection.confidence >= LEAST_CONFIDENCE
            if new and all(abs(place - track.along_m) > _DOUBLE_M + sighting.error_m for track, _ in tracks):
                tracks.append((LeadTrack.begun(sighting, front_along_m, speed_m_s), sighting))
        self._tracks = tracks
        sure = [each for each in tracks if each[0].sure]
        if not sure:
            return None
        track, sighting = min(sure, key=lambda each: each[0].along_m)
        return WatchedLead(Lead(track.along_m - front_along_m, track.speed_m_s), track, sighting)


def _nearest(track: LeadTrack, seen: Sequence[Sighting], front_along_m: float) -> Sighting | None:
    """The sighting that lies nearest to where somebody was expected, if near enough."""
    near = [(away, each) for each in seen if (away := track.distance(each, front_along_m)) is not None]
    return min(near, key=lambda each: each[0])[1] if near else None
