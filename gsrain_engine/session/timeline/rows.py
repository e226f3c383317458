"""What stands on the timeline below the camera's keys: who is there from when to when, and how fast the ego drives."""

from typing import NamedTuple

import numpy as np

from gsrain_engine.rain.weather import WITHOUT_CHANGE, Weather
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.track import Track

from ..view.home_camera import ORBIT_S


class TimelineRow(NamedTuple):
    """One line of the timeline."""

    title: str
    help: str
    spans_s: list[tuple[float, float]]
    """From when to when something is there."""
    keys_s: tuple[float, ...] = ()


def content_span(scene: Scene, weather: Weather = WITHOUT_CHANGE) -> tuple[float, float]:
    """From when to when something happens: the person's flight; else drive, traffic and weather; else one swing."""
    if scene.path is not None and scene.path.duration_s > 0:
        return scene.path.start_s, scene.path.end_s
    tracks = [actor.track for actor in scene.actors] + ([scene.ego] if scene.ego is not None else [])
    times = [(float(track.times[0]), float(track.times[-1])) for track in tracks if len(track.times) > 1]
    if len(weather.keys) > 1:
        times.append((weather.keys[0].time_s, weather.keys[-1].time_s))
    if not times:
        return 0.0, ORBIT_S
    return max(0.0, min(first for first, _ in times)), max(last for _, last in times)


def track_rows(scene: Scene) -> list[TimelineRow]:
    """The ego vehicle and the actors."""
    rows: list[TimelineRow] = []
    if scene.ego is not None:
        rows.append(TimelineRow("ego vehicle", "The vehicle that carries the cameras.", presence(scene.ego)))
    for actor in scene.actors:
        help_text = f"{actor.class_name or 'actor'}, in the scene while the bar lasts."
        rows.append(TimelineRow(actor.name, help_text, presence(actor.track)))
    return rows


def weather_row(weather: Weather, first_s: float, last_s: float, most: int) -> TimelineRow:
    """Keys of the rain within a stretch of time, at most so many of them: more would stand on top of one another."""
    times = weather.times_s
    seen = times[(times >= first_s) & (times <= last_s)]
    thinned = seen[:: max(1, -(-len(seen) // most))]
    spans = [(weather.keys[0].time_s, weather.keys[-1].time_s)] if len(weather.keys) > 1 else []
    return TimelineRow(
        "rain", "Keys of intensity, wind and exposure, set in the Shower panel.", spans, (*thinned.tolist(),)
    )


def presence(track: Track) -> list[tuple[float, float]]:
    """From when to when a track's thing is in the scene, between its first sample and its last."""
    there = track.valid[:-1].astype(np.int8)
    edges = np.diff(np.concatenate([[0], there, [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [(float(track.times[a]), float(track.times[b])) for a, b in zip(starts, ends, strict=True)]


def ego_speed_km_h(scene: Scene, time_s: float) -> float | None:
    """How fast the ego vehicle drives; None where there is none at that time."""
    track = scene.ego
    if track is None or len(track.times) < 2 or not track.times[0] <= time_s <= track.times[-1]:
        return None
    k = min(int(np.searchsorted(track.times, time_s, side="right")) - 1, len(track.times) - 2)
    if not track.valid[k]:
        return None
    way = float(np.linalg.norm(track.positions[k + 1] - track.positions[k])) * scene.metres_per_unit
    return 3.6 * way / float(track.times[k + 1] - track.times[k])
