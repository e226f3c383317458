"""Named views of a scene: cameras to come back to, each with the time and the rain of the moment or without."""

import difflib
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float64
from msgspec import Meta, structs

from ..settings import Settings
from .camera import Camera
from .geometry import matrices_from_quaternions, normalized, quaternions_from_matrices

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
MAX_VIEWS = 1000
"""Views of a scene."""
_LONGEST_NAME = 200
_FARTHEST, _NOT_UNIT = 1e12, 1e-3  # larger numbers, and other quaternions, come from damaged files


class NamedView(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A named view, in units and axes of the scene. Camera axes are OpenCV's (x right, y down, z forward)."""

    name: str
    """Unique in a scene: 1 to 200 printable characters, without spaces at the ends."""
    position: Vector
    quaternion_wxyz: Quaternion
    """Camera to scene, unit."""
    vertical_fov_deg: Annotated[float, Meta(ge=1e-4, lt=180)] = 50.0
    target: Vector | None = None
    """Point that a drag orbits in the window; None leaves its distance as it is."""
    orthographic: bool = False
    """True for parallel rays, with the scale that the camera's picture has at the target."""
    time_s: Annotated[float, Meta(ge=0, le=1e9)] | None = None
    """Time of scene and rain in seconds; None leaves the time as it is."""
    rain: dict[str, Any] | None = None
    """Rain settings as plain values, below any rain keyframes of the scene; None leaves the rain as it is."""
    picture: Annotated[bytes, Meta(max_length=1 << 16)] | None = None
    """Small JPEG picture for lists of views."""

    def __post_init__(self) -> None:
        super().__post_init__()
        name = self.name
        # Values of files have their types already, those of Python may not.
        types = type(name), type(self.rain)
        if types not in ((str, dict), (str, type(None))):
            raise TypeError("a view needs a text as its name, and a dictionary or None as its rain")
        if not 0 < len(name) <= _LONGEST_NAME or name != name.strip() or not name.isprintable():
            raise ValueError(
                f"view {name[:_LONGEST_NAME]!r}: a name has 1 to {_LONGEST_NAME} printable characters, "
                "without spaces at its ends"
            )
        numbers = (*self.position, *(self.target or ()), *self.quaternion_wxyz)
        if not (np.isfinite(numbers).all() and np.abs(numbers).max() < _FARTHEST):
            raise ValueError(f"view {name!r}: position, target and quaternion_wxyz must be finite numbers")
        if not abs(np.linalg.norm(self.quaternion_wxyz) - 1) < _NOT_UNIT:
            raise ValueError(f"view {name!r}: quaternion_wxyz {list(self.quaternion_wxyz)} must have the length 1")
        if self.orthographic and (self.target is None or self.target == self.position):
            raise ValueError(f"view {name!r}: an orthographic view needs a target away from its position")

    @classmethod
    def of(cls, name: str, camera: Camera, **fields: Any) -> "NamedView":
        """View of a camera in units and axes of the scene. Raises `ValueError` for a name that is not allowed."""
        if camera.is_orthographic:
            # A pinhole before the picture plane, by as much as the picture is high there
            away_m, ahead = camera.height / camera.pixels_per_m, camera.world_to_camera[2, :3]
            target = camera.position + camera.plane_m * ahead
            pinhole = camera.shifted(ahead=camera.plane_m - away_m)
            fx, fy = camera.pixels_per_m * away_m * camera.fx / camera.fy, camera.pixels_per_m * away_m
            camera = replace(pinhole, fx=fx, fy=fy, plane_m=0.0)
            fields = {"target": tuple(target.tolist()), "orthographic": True} | fields
        x, y, z = camera.position.tolist()
        a, b, c, d = quaternions_from_matrices(camera.camera_to_world[None, :3, :3])[0].tolist()
        fov_deg = float(camera.vertical_fov_deg)
        return cls(name=name, position=(x, y, z), quaternion_wxyz=(a, b, c, d), vertical_fov_deg=fov_deg, **fields)

    @property
    def intensity_mm_h(self) -> float | None:
        """Rainfall intensity; None for a view without rain."""
        rate = None if self.rain is None else self.rain.get("intensity_mm_h", 0.0)
        return float(rate) if isinstance(rate, int | float) else None

    @property
    def contents(self) -> str:
        """Describe what the view holds besides the camera, such as "2.5 s, 8.5 mm/h"."""
        rate = self.intensity_mm_h
        time = [f"{self.time_s:.4g} s"] if self.time_s is not None else []
        return ", ".join([*time, f"{rate:g} mm/h"] if rate is not None else time)

    def camera(self, width: int, height: int) -> Camera:
        """Pinhole of an image size in pixels, in units and axes of the scene."""
        pose = np.eye(4)
        pose[:3, :3] = matrices_from_quaternions(normalized(np.array(self.quaternion_wxyz, np.float64)))
        pose[:3, 3] = self.position
        return Camera.from_fov(width, height, self.vertical_fov_deg, np.linalg.inv(pose))

    def moved(self, similarity: Float64[np.ndarray, "4 4"]) -> "NamedView":
        """View in a scene that was moved by a similarity."""
        moved = NamedView.of(self.name, self.camera(2, 2).moved(similarity))
        fields: dict[str, Any] = {"position": moved.position, "quaternion_wxyz": moved.quaternion_wxyz}
        if self.target is not None:
            x, y, z = (similarity[:3, :3] @ self.target + similarity[:3, 3]).tolist()
            fields["target"] = (x, y, z)
        return structs.replace(self, **fields)


def check_views(views: Sequence[NamedView]) -> None:
    """Raise `ValueError` if two views have one name, or there are too many."""
    names = [view.name for view in views]
    if len(names) > MAX_VIEWS:
        raise ValueError(f"{len(names):,} views are more than the {MAX_VIEWS:,} that a scene can have - at `$.views`")
    twice = next((number for number, name in enumerate(names) if name in names[:number]), None)
    if twice is not None:
        raise ValueError(f"there are two views named {names[twice]!r} - at `$.views[{twice}]`")


def view_named(views: Sequence[NamedView], name: str, scene: str) -> NamedView:
    """Find a view by its name. Raises `ValueError`, with the most similar name or all, if the scene has none such."""
    found = next((view for view in views if view.name == name), None)
    if found is not None:
        return found
    if not views:
        raise ValueError(f"view {name!r}: scene {scene!r} has no named views")
    names = [view.name for view in views]
    folded = {each.casefold(): each for each in reversed(names)}
    like = difflib.get_close_matches(name.casefold(), list(folded), 1)
    hint = f"did you mean {folded[like[0]]!r}?" if like else f"it has {', '.join(map(repr, names[:_LISTED]))}"
    raise ValueError(f"view {name!r}: scene {scene!r} has no view of this name; {hint}")


_LISTED = 8  # names in an error
