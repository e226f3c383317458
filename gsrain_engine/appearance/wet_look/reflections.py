"""Planar reflection in the ground: mirrored camera, screen-space reflection, and hole filling."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, no_type_check

import cv2
import numpy as np
from jaxtyping import Bool, Float32
from scipy import ndimage

from ...kernels import kernel, range_of
from ...scene.camera import Camera
from ..base import ClearView, Image, Plane
from ..normals import view_rays
from .ground_plane import GroundPlane
from .masks import VisibleGround

_BELOW_HORIZON, _MARGIN_SHARES = 0.02, 0.08
"""Margins of the mirror image, as parts of its height and width: rough water reflects from beyond its borders."""
_ABOVE = 0.35  # tangent by which the mirror image extends higher than a flat mirror's


@dataclass(frozen=True, slots=True, eq=False)
class PlanarReflection:
    """Mirror image of a camera below the ground, upright: from the view itself where it shows the same point."""

    beyond: ClearView
    """Environment outside the view; sky where it is empty."""
    places: Float32[np.ndarray, "h w 2"]
    """Columns and rows in the view (pixel centers at halves) of the reflected points."""
    known: Plane
    """Share of each pixel that is from the view, 0..1; the rest is `beyond`."""
    depth: Plane
    """Meters along the mirror camera's axis; 0 for sky."""

    def picture(self, view: Float32[np.ndarray, "_ _ 3"], beyond: Image) -> Image:
        """Combine the rainy image of the view and that of `beyond`."""
        columns, rows = (np.ascontiguousarray(self.places[..., k]) - np.float32(0.5) for k in (0, 1))
        mirrored = cv2.remap(view, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return beyond + self.known[..., None] * (mirrored - beyond)


def mirror_camera(camera: Camera, plane: GroundPlane, scale: float) -> Camera:
    """Return the mirrored camera, cropped to what the ground can reflect and widened by a margin.

    `scale` is its resolution relative to the eye's. Reflected rays rise, so the image ends at the horizon of the
    mirrored camera.
    """
    turned = plane.mirrored(camera)
    turn = turned.world_to_camera[:3, :3]
    up = turn @ plane.normal  # in camera axes (x right, y down, z forward)
    left, right = (-turned.cx / turned.fx, (turned.width - turned.cx) / turned.fx)
    top, bottom = (-turned.cy / turned.fy, (turned.height - turned.cy) / turned.fy)
    # The horizon is where up . (x, y, 1) = 0; rows grow downwards, so up[1] < 0 for an upright camera.
    horizon = max(-(up[0] * x + up[2]) / up[1] for x in (left, right)) if up[1] < -0.2 else bottom
    height = bottom - top
    low = min(horizon + _BELOW_HORIZON * height, bottom + _BELOW_HORIZON * height)
    high = top - _ABOVE
    wide = _MARGIN_SHARES * (right - left)
    fx, fy = turned.fx * scale, turned.fy * scale
    width, rows = round((right - left + 2 * wide) * fx), max(round((low - high) * fy), 8)
    return replace(turned, width=width, height=rows, fx=fx, fy=fy, cx=-(left - wide) * fx, cy=-high * fy)


# Screen-space reflection: mirrored rays traced through the view's depth

_GROUND = 0.5
_FIRST_M, _GROWTH, _STEPS = 0.03, 1.12, 84
"""Length of the first step, growth factor of steps, and their number: about 400 m in all."""
_HALVINGS = 6
_THICK_M, _THICK_SHARE = 0.2, 0.03
"""Assumed thickness of surfaces: a ray farther behind one is occluded and has not hit it."""


class SsrHits(NamedTuple):
    """Hits of screen-space reflection, per pixel of the mirror image."""

    places: Float32[np.ndarray, "h w 2"]
    """Columns and rows in the view (pixel centers at halves); without a hit, where the ray left the view."""
    depth: Plane
    """Along the mirror camera's axis in meters; 0 for sky."""
    found: Bool[np.ndarray, "h w"]
    left: Bool[np.ndarray, "h w"]
    """True where the ray left the image in front of all visible surfaces."""

    def with_hidden_filled(self) -> "SsrHits":
        """Fill rays that neither hit nor left the image with the nearest hit in the mirror image."""
        hidden = ~self.found & ~self.left
        if not self.found.any():
            return self
        nearest: Any = ndimage.distance_transform_edt(~self.found, return_distances=False, return_indices=True)
        rows, columns = nearest
        places = np.where(hidden[..., None], self.places[rows, columns], self.places)
        depth = np.where(hidden, self.depth[rows, columns], self.depth)
        return SsrHits(places, depth, self.found | hidden, self.left)


def screen_space_reflection(view: ClearView, ground: VisibleGround, mirror: Camera) -> SsrHits:
    """Trace the mirror image's rays, each from the point where it leaves the ground, through the view's depth."""
    size = (mirror.height, mirror.width)
    places, depth = np.zeros((*size, 2), np.float32), np.zeros(size, np.float32)
    found, left = np.zeros(size, np.bool_), np.zeros(size, np.bool_)
    solid = np.where((ground.share > _GROUND) | (view.depth <= 0), np.float32(np.inf), view.depth)
    _follow(
        solid, view.depth <= 0, view.camera.world_to_camera, focal_and_center(view.camera), mirror.camera_to_world,
        focal_and_center(mirror), ground.plane.normal, ground.plane.offset_m, places, depth, found, left,
    )  # fmt: skip
    return SsrHits(places, depth, found, left)


def focal_and_center(camera: Camera) -> tuple[float, float, float, float]:
    return float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _follow(
    portion, solid, is_sky, pose, eye_lens, mirror_pose, mirror_lens, normal, offset, places, depth, found, left
):
    rows, columns = solid.shape
    turn = np.ascontiguousarray(pose[:3, :3])
    for v in range_of(portion, depth.shape[0]):
        for u in range(depth.shape[1]):
            x, y = (u + 0.5 - mirror_lens[2]) / mirror_lens[0], (v + 0.5 - mirror_lens[3]) / mirror_lens[1]
            direction = mirror_pose[:3, 0] * x + mirror_pose[:3, 1] * y + mirror_pose[:3, 2]
            rise = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
            below = offset - (
                normal[0] * mirror_pose[0, 3] + normal[1] * mirror_pose[1, 3] + normal[2] * mirror_pose[2, 3]
            )
            if rise <= 1e-4 or below <= 0:
                continue
            start = below / rise
            origin = mirror_pose[:3, 3] + start * direction
            a = turn @ origin + pose[:3, 3]
            b = turn @ direction
            way, before, hidden = 0.0, 0.0, False
            step = _FIRST_M
            last_u, last_v, is_out = 0.0, 0.0, False
            for _ in range(_STEPS):
                before, way = way, way + step
                step *= _GROWTH
                z = a[2] + way * b[2]
                if z <= 0.05:
                    is_out = True
                    break
                pu = (a[0] + way * b[0]) / z * eye_lens[0] + eye_lens[2]
                pv = (a[1] + way * b[1]) / z * eye_lens[1] + eye_lens[3]
                if not (0 <= pu < columns and 0 <= pv < rows):  # also NaN
                    is_out = True
                    last_u, last_v = min(max(0.5, pu), columns - 0.5), min(max(0.5, pv), rows - 0.5)
                    break
                last_u, last_v = pu, pv
                behind = z - solid[int(pv), int(pu)]
                if behind <= 0:
                    continue
                if behind > abs(way - before) * abs(b[2]) * 1.5 + _THICK_M + _THICK_SHARE * z:
                    hidden = True
                    continue
                low, high = before, way
                for _ in range(_HALVINGS):
                    middle = 0.5 * (low + high)
                    z = a[2] + middle * b[2]
                    mu = (a[0] + middle * b[0]) / z * eye_lens[0] + eye_lens[2]
                    mv = (a[1] + middle * b[1]) / z * eye_lens[1] + eye_lens[3]
                    mu, mv = min(max(0.0, mu), columns - 1.0), min(max(0.0, mv), rows - 1.0)
                    if z > solid[int(mv), int(mu)]:
                        high = middle
                    else:
                        low = middle
                way = high
                z = a[2] + way * b[2]
                places[v, u, 0] = (a[0] + way * b[0]) / z * eye_lens[0] + eye_lens[2]
                places[v, u, 1] = (a[1] + way * b[1]) / z * eye_lens[1] + eye_lens[3]
                depth[v, u] = start + way  # the ray is one meter of the mirror camera's depth long
                found[v, u] = not hidden
                break
            else:
                if not hidden and is_sky[int(last_v), int(last_u)]:
                    places[v, u, 0], places[v, u, 1] = last_u, last_v
                    found[v, u] = True
            if is_out:
                places[v, u, 0], places[v, u, 1] = last_u, last_v
                left[v, u] = not hidden


# Holes near the horizon of the mirror image are occluded surfaces, not sky

_LOW = 0.06  # rise of rays (3.4 degrees) up to which the world always covers the sky


def fill_reflection_holes(view: ClearView, plane: GroundPlane) -> ClearView:
    """Extend surfaces above a gap near the horizon down into it, under cars or where the captured world ends.

    Gaps with nothing above them become sky.
    """
    rays = view_rays(view.camera)
    rise = (rays @ plane.normal) / np.linalg.norm(rays, axis=-1)
    gap = (view.depth <= 0) & (rise < _LOW)
    rows = np.arange(gap.shape[0])[:, None]
    above = np.maximum.accumulate(np.where(gap, -1, np.where(view.depth > 0, rows, -1)), axis=0)
    filled = gap & (above >= 0)
    source, columns = np.where(filled, above, rows), np.arange(gap.shape[1])[None]
    maps = {name: getattr(view, name)[source, columns] for name in ("image", "depth", "normals", "sky", "vehicles")}
    maps["sky"] = np.where(maps["depth"] > 0, maps["sky"], np.float32(1))
    return replace(view, **maps)
