"""What is believed of one road user in the lane, from sightings over time: an alpha-beta filter."""

from dataclasses import dataclass, replace

import numpy as np

from .sighting import Sighting

_ACCELERATION_M_S2 = 4.0
"""Standard deviation of what a lead does to its speed: so that braking with 8 m/s2 is rare, not unheard of."""
_GATE = 3.0
"""Standard deviations; what lies farther from where somebody was expected is somebody else."""
_GATE_M = 1.5
"""Room in addition, for detectors whose boxes jump."""
_COAST_S, _NEAR_COAST_S = 1.0, 30.0
_NEAR_M, _STANDS_M_S = 6.0, 0.5
"""Without sightings somebody is believed for a second: longer than wipers and gusts of rain take. Detectors lose who is
so near that it leaves the picture below; if it drives on, it is seen again, and if not, setting off would hit it: until
then it is taken to stand where it stood, for half a minute at most."""
LEAST_CONFIDENCE = 0.3
"""Less confident sightings begin nothing and confirm nothing; they keep in view who is known. Detectors of COCO find
the most, at few false alarms, from 0.25 to 0.4 on."""
_SURE = 0.6
"""Confidence that is enough to act on a first sight; the less confident must be seen twice."""


@dataclass(frozen=True, slots=True)
class LeadTrack:
    """Somebody in the lane. Its place is counted along the route, in which the own motion is known and cancels."""

    class_name: str
    along_m: float
    """Nearest of it, on the route."""
    speed_m_s: float
    """Along the route."""
    place_variance_m2: float
    covariance_m2_s: float
    speed_variance_m2_s2: float
    seen: int = 1
    """Sightings."""
    unseen_s: float = 0.0
    """Since the last one."""
    sure: bool = False

    @classmethod
    def begun(cls, sighting: Sighting, front_along_m: float, own_speed_m_s: float) -> "LeadTrack":
        """Return what is believed on first sight: that it is about as fast as the own vehicle, or slower, or stands."""
        half = 0.5 * own_speed_m_s
        return cls(
            sighting.detection.class_name, front_along_m + sighting.gap_m, half, sighting.error_m**2, 0.0,
            (half + 1.0) ** 2, sure=sighting.detection.confidence >= _SURE,
        )  # fmt: skip

    def later(self, dt_s: float) -> "LeadTrack":
        """Return what is believed a time later, at constant speed."""
        q = (_ACCELERATION_M_S2 * dt_s) ** 2
        lost_standing = self.unseen_s > 0 and abs(self.speed_m_s) < _STANDS_M_S
        speed = 0.0 if lost_standing else self.speed_m_s
        return replace(
            self,
            along_m=self.along_m + speed * dt_s,
            speed_m_s=speed,
            place_variance_m2=self.place_variance_m2
            + dt_s * (2 * self.covariance_m2_s + dt_s * self.speed_variance_m2_s2)
            + q * dt_s * dt_s / 4,
            covariance_m2_s=self.covariance_m2_s + dt_s * self.speed_variance_m2_s2 + q * dt_s / 2,
            speed_variance_m2_s2=self.speed_variance_m2_s2 + q,
            unseen_s=self.unseen_s + dt_s,
        )

    def seen_again(self, sighting: Sighting, front_along_m: float) -> "LeadTrack":
        """Return what is believed after a sighting of it.

        Gains are the best for the errors (Kalman's, for constant speed): alpha corrects the place, beta over the time
        between sightings the speed. With equal errors they settle at Kalata's (1984); with a fixed pair near and far
        could not both be right, for the error of a distance grows with its square.
        """
        surprise = front_along_m + sighting.gap_m - self.along_m
        total = self.place_variance_m2 + sighting.error_m**2
        alpha, speed_gain = self.place_variance_m2 / total, self.covariance_m2_s / total
        return replace(
            self,
            class_name=sighting.detection.class_name,
            along_m=self.along_m + alpha * surprise,
            speed_m_s=self.speed_m_s + speed_gain * surprise,
            place_variance_m2=(1 - alpha) * self.place_variance_m2,
            covariance_m2_s=(1 - alpha) * self.covariance_m2_s,
            speed_variance_m2_s2=self.speed_variance_m2_s2 - speed_gain * self.covariance_m2_s,
            seen=self.seen + 1,
            unseen_s=0.0,
            sure=self.sure or sighting.detection.confidence >= LEAST_CONFIDENCE,
        )

    def distance(self, sighting: Sighting, front_along_m: float) -> float | None:
        """Return how far from the expected place a sighting is (m); none where it is too far to be the same."""
        away = abs(front_along_m + sighting.gap_m - self.along_m)
        return away if away <= _GATE_M + _GATE * np.sqrt(self.place_variance_m2 + sighting.error_m**2) else None

    def believed(self, front_along_m: float) -> bool:
        """Whether it is still taken to be there. The unsure one that is missed once was none."""
        if not self.sure:
            return self.unseen_s == 0
        near = self.along_m - front_along_m < _NEAR_M
        return self.unseen_s <= (_NEAR_COAST_S if near else _COAST_S) + 1e-9
