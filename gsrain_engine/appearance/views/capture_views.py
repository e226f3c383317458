"""Clear views of a capture: its pictures without distortion, with what can be found out about each pixel."""

import numpy as np
from jaxtyping import Bool, Float64

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.prepared import prepared
from gsrain_engine.scene.scene import rotation_to_z_up

from ..clear_view import ClearView
from ..normals.from_depth import normals_from_depth
from .capture_surfaces import CaptureSurfaces
from .kept_views import KeptViews
from .vehicle_pixels import vehicle_pixels


class CaptureViews(KeptViews):
    """Views of a capture in the world (metres, z up), each worked out when it is asked for; the last few are kept."""

    def __init__(self, capture: Capture, width_px: int) -> None:
        """Take a capture; nothing is read before it is asked for. Wider pictures are made smaller."""
        super().__init__(len(capture), self._view)
        self._capture = capture
        self._straight = [prepared(view, min(width_px, view.camera.width)) for view in capture]
        self._surfaces = CaptureSurfaces(capture)
        self._has_poses = capture.has_poses and not _stand_at_one_place(capture)

    @property
    def to_world(self) -> Float64[np.ndarray, "4 4"]:
        """Similarity from the capture's unit and axes to the world."""
        matrix = np.eye(4)
        matrix[:3, :3] = self._surfaces.metres_per_unit * rotation_to_z_up(self._capture.up)
        return matrix

    def mask(self, name: str) -> Bool[np.ndarray, "h w"] | None:
        """Which pixels of a view the lens saw and may be learned from; None means all."""
        return next(view.mask for view in self._straight if view.name == name)

    def _view(self, index: int) -> ClearView:
        view, to_world = self._straight[index], self.to_world
        scale = np.float32(self._surfaces.metres_per_unit)
        sky = self._surfaces.sky(view)
        depth = self._surfaces.depth(view, sky > 0.5)
        known = self._surfaces.known_share(view, sky > 0.5) if depth.any() else 0.0
        camera = view.camera.moved(to_world)
        own = view.normals
        turned = None if own is None else (own @ (to_world[:3, :3] / scale).T).astype(np.float32)
        depth_m = (scale * depth).astype(np.float32)
        return ClearView(
            view.name,
            camera,
            view.time_s,
            view.image.astype(np.float32) / np.float32(255),
            depth_m,
            normals_from_depth(depth_m, camera) if turned is None else turned,
            sky,
            vehicle_pixels(view, self._capture.boxes, depth).astype(np.float32),
            view.sensor,
            has_pose=self._has_poses,
            known_share=known,
        )


def _stand_at_one_place(capture: Capture) -> bool:
    """Whether poses are the same number time and again, and nothing measured speaks for a camera at rest."""
    is_measured = (
        capture.sweeps or capture.points_m is not None or any(view.depth_source is not None for view in capture)
    )
    first = capture[0].camera.world_to_camera
    return len(capture) > 1 and not is_measured and all(
        np.allclose(view.camera.world_to_camera, first, rtol=0, atol=1e-9) for view in capture
    )  # fmt: skip


def capture_views(capture: Capture, width_px: int) -> CaptureViews:
    """Views of a capture, with pictures at most so wide.

    Depth comes from the capture's own, or from its lidar or its points, made dense; the sky from its masks, or from
    colours and what was measured; vehicles from labels or boxes. What is not known is 0.
    """
    return CaptureViews(capture, width_px)
