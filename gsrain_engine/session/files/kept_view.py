"""The view that goes with a saved scene: from where, and how, it was looked at."""

import logging
from collections.abc import Mapping
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from gsrain_engine.render.look import Look

from ..document.viewed_document import ViewedDocument
from ..view.navigation import FASTEST_M_S, SLOWEST_M_S, Navigation

logger = logging.getLogger("gsrain")

_Triple = tuple[float, float, float]


class KeptView(msgspec.Struct, frozen=True, kw_only=True):
    """World frame (metres, z up). What a newer program has written besides is passed over."""

    position: _Triple
    heading: float
    """Radians from +x to +y."""
    pitch: float
    """Radians, upwards."""
    distance_m: Annotated[float, Meta(gt=0)]
    vertical_fov_deg: Annotated[float, Meta(gt=0, lt=180)]
    speed_m_s: Annotated[float, Meta(ge=SLOWEST_M_S, le=FASTEST_M_S)]
    time_s: float = 0.0
    background: _Triple = (0.0, 0.0, 0.0)
    gain_ev: Annotated[float, Meta(ge=-10, le=10)] = 0.0
    look: Look = "splats"


def kept_view(session: ViewedDocument) -> dict[str, Any]:
    """Plain values of what a session looks at now."""
    eye, view = session.navigation, session.view
    x, y, z = eye.position.tolist()
    kept = KeptView(
        position=(x, y, z),
        heading=float(eye.heading),
        pitch=float(eye.pitch),
        distance_m=float(eye.distance_m),
        vertical_fov_deg=float(eye.vertical_fov_deg),
        speed_m_s=float(eye.speed_m_s),
        time_s=float(session.clock.time_s),
        background=view.background,
        gain_ev=view.gain_ev,
        look=view.look,
    )
    return msgspec.to_builtins(kept)


def look_again(session: ViewedDocument, values: Mapping[str, Any]) -> None:
    """Look from where a scene was looked at when it was saved; values that can't be used are told of and left."""
    try:
        kept = msgspec.convert(values, KeptView)
    except msgspec.ValidationError as error:
        logger.warning("%s: the saved view can't be used: %s", session.scene.name, error)
        return
    session.navigation = Navigation(
        np.array(kept.position), kept.heading, kept.pitch, kept.distance_m, kept.vertical_fov_deg, kept.speed_m_s
    )
    session.clock.time_s = kept.time_s
    session.view.background, session.view.gain_ev, session.view.look = kept.background, kept.gain_ev, kept.look
