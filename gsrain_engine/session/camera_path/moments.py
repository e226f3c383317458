"""Moments of the timeline: frames of the film, keys to go to, and what is played."""

import numpy as np

from ..document.viewed_document import ViewedDocument


def set_span(session: ViewedDocument, is_start: bool, time_s: float) -> None:
    """Set where playing starts or ends, at least a frame apart."""
    start, end = session.span_s
    moment, frame = max(0.0, on_frame(session, time_s)), 1 / session.timeline.fps
    session.clock.span_s = (min(moment, end - frame), end) if is_start else (start, max(moment, start + frame))


def on_frame(session: ViewedDocument, time_s: float) -> float:
    return round(time_s * session.timeline.fps) / session.timeline.fps


def go_to_key(session: ViewedDocument, key: int) -> None:
    """Choose a key and look through it: stop the clock at its moment and ride along."""
    path = session.scene.path
    if path is not None:
        session.timeline.key = key
        session.clock.playing = False
        session.clock.seek(float(path.times_s[key]))
        session.view.follow_path = True


def go_to_next_key(session: ViewedDocument, steps: int) -> None:
    """Go to the key before (-1) or after (1) the clock's moment; at the ends stay."""
    path, now = session.scene.path, session.clock.time_s
    if path is None:
        return
    beyond = path.times_s > now + 1e-6 if steps > 0 else path.times_s < now - 1e-6
    keys = np.flatnonzero(beyond)
    if len(keys):
        go_to_key(session, int(keys[0] if steps > 0 else keys[-1]))
