"""Poses against the lidar: whether edges in depth lie on edges of the pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from ..capture import Capture, CaptureError, View
from ..geometry.lidar_depth import nearest_sweep
from . import lidar_fit
from .lidar_fit import EdgePicture
from .pose_hypotheses import hypotheses
from .pose_verdict import PoseCheck, judged, spread

STANDS_OUT = 1.5
"""Standard deviations that a right pose's fit is above that of turned ones. Seen: 1.9-7.8 a view, wrong -2.9-2.7."""

_VIEWS = 4
_WITHIN_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    view: View
    edges: EdgePicture
    depth_edges: Float64[np.ndarray, "e 3"]


def check_by_lidar(capture: Capture, sensor: str) -> PoseCheck | None:
    """Check one camera; None where no sweep is near its times."""
    seen = _seen(capture, [view for view in capture if view.sensor == sensor])
    if not seen:
        return None
    figure = _stands_out(seen, [each.view.camera.world_to_camera for each in seen])
    others = {other.told: _stands_out(seen, other.poses) for other in hypotheses(capture, [each.view for each in seen])}
    verdict, why = judged(figure, STANDS_OUT, others, STANDS_OUT + 2 / np.sqrt(len(seen)))
    told = (
        f"{sensor or 'the camera'}: edges in the lidar's depth meet edges of the pictures {figure:.1f} standard "
        f"deviations better than under turned poses (expected over {STANDS_OUT:g}; views: {len(seen)}){why}"
    )
    return PoseCheck(sensor, "lidar", verdict, figure, STANDS_OUT, told)


def _stands_out(seen: Sequence[_Seen], poses: Sequence[Float64[np.ndarray, "4 4"]]) -> float:
    """Mean fit of world-to-camera poses; a view into which hardly any point falls counts as 0."""
    fits = [
        lidar_fit.fit(each.edges, each.depth_edges, replace(each.edges.view.camera, world_to_camera=pose))
        for each, pose in zip(seen, poses, strict=True)
    ]
    return float(np.mean(np.nan_to_num(fits, nan=0.0)))


def _seen(capture: Capture, views: Sequence[View]) -> list[_Seen]:
    """Some views over the drive with the sweep nearest in time; broken pictures are another check's finding."""
    seen: list[_Seen] = []
    for view in spread(views, _VIEWS):
        sweep = nearest_sweep(view, capture.sweeps)
        if sweep is None or abs(sweep.time_s - view.time_s) > _WITHIN_S:
            continue
        try:
            seen.append(_Seen(view, lidar_fit.edge_picture(view), lidar_fit.depth_edges(sweep)))
        except CaptureError:
            continue
    return seen
