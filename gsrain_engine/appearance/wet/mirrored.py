"""What the ground mirrors, as a picture: taken by a camera that stands where the eye's mirror image is."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.camera import Camera

from ..clear_view import ClearView
from .ground_plane import GroundPlane

_BELOW_HORIZON, _BESIDE = 0.02, 0.08
"""Parts of the picture's height and width that the mirror's picture shows more: rough water looks past its edges."""
_ABOVE = 0.35
"""Tangent by which it looks higher than the flat mirror does."""


@dataclass(frozen=True, slots=True, eq=False)
class Mirrored:
    """The picture in the mirror, by the camera below the ground, upright: from the view where the view shows it too."""

    beyond: ClearView
    """What is not seen in the view; where nothing of the world is, it is sky."""
    places: Float32[np.ndarray, "h w 2"]
    """Columns and rows in the view (pixel centres at halves) that show what is mirrored."""
    known: Float32[np.ndarray, "h w"]
    """How much of each pixel is taken from there, 0..1; the rest is `beyond`."""
    depth: Float32[np.ndarray, "h w"]
    """Metres along the mirror camera's axis; 0 for sky."""

    @property
    def camera(self) -> Camera:
        """In the world, below the ground."""
        return self.beyond.camera

    def picture(
        self, seen: Float32[np.ndarray, "_ _ 3"], beyond: Float32[np.ndarray, "h w 3"]
    ) -> Float32[np.ndarray, "h w 3"]:
        """Put together what the view shows and what is beyond it, each as the rainy day makes it look."""
        columns, rows = (np.ascontiguousarray(self.places[..., k]) - np.float32(0.5) for k in (0, 1))
        taken = cv2.remap(seen, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return beyond + self.known[..., None] * (taken - beyond)


def mirror_camera(camera: Camera, plane: GroundPlane, scale: float) -> Camera:
    """Return the mirrored camera, cropped to what the ground can mirror and widened by a margin.

    `scale` is its resolution relative to the eye's. Rays that the ground mirrors rise: what lies under the horizon of
    the mirrored camera is left out.
    """
    turned = plane.mirrored(camera)
    turn = turned.world_to_camera[:3, :3]
    up = turn @ plane.normal  # in camera axes (x right, y down, z forward)
    left, right = (-turned.cx / turned.fx, (turned.width - turned.cx) / turned.fx)
    top, bottom = (-turned.cy / turned.fy, (turned.height - turned.cy) / turned.fy)
    corners = np.array([[x, y, 1.0] for x in (left, right) for y in (top, bottom)])
    # The horizon is where up . (x, y, 1) = 0; rows grow downwards, so up[1] < 0 for an upright camera.
    horizon = max(-(up[0] * x + up[2]) / up[1] for x in (left, right)) if up[1] < -0.2 else float(corners[:, 1].max())
    height = bottom - top
    low = min(horizon + _BELOW_HORIZON * height, bottom + _BELOW_HORIZON * height)
    high = top - _ABOVE
    wide = _BESIDE * (right - left)
    fx, fy = turned.fx * scale, turned.fy * scale
    width, rows = round((right - left + 2 * wide) * fx), max(round((low - high) * fy), 8)
    return replace(turned, width=width, height=rows, fx=fx, fy=fy, cx=-(left - wide) * fx, cy=-high * fy)
