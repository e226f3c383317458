"""The rain regions as lines in the picture."""

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from gsrain_engine.rain.rain import Box
from gsrain_engine.render.scene_view import rain_anchor
from gsrain_engine.scene.box_corners import EDGES
from gsrain_engine.scene.camera import Camera

from ..document.viewed_document import ViewedDocument
from ..view.projection import projected_lines


class RegionOutline(NamedTuple):
    """The edges of one region."""

    name: str
    lines_px: Float64[np.ndarray, "m 2 2"]
    """Start and end of each edge that is in front of the camera, as x, y in pixels of the picture."""


def region_outlines(session: ViewedDocument, width: int, height: int) -> list[RegionOutline]:
    """Project the regions that the view options ask for."""
    shown = []
    if session.view.show_streak_region:
        shown.append(("streak region", session.rain.streak_region))
    if session.view.show_haze_region:
        shown.append(("haze region", session.rain.haze_region))
    shot = session.shot(width, height)
    anchor = rain_anchor(session.shown_scene, session.shown_rainfall, shot)
    return [RegionOutline(name, project_edges(box, anchor, shot.camera)) for name, box in shown]


def project_edges(
    box: Box, anchor_to_world: Float64[np.ndarray, "4 4"], camera: Camera
) -> Float64[np.ndarray, "m 2 2"]:
    """Project the twelve edges of a box, each cut off at the near plane."""
    corners = np.array(list(product(*zip(box.minimum_m, box.maximum_m, strict=True))))
    in_world = corners @ anchor_to_world[:3, :3].T + anchor_to_world[:3, 3]
    return projected_lines(in_world[EDGES], camera)
