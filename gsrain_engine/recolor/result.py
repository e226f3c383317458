"""Results of a recoloring: their file (.npz without pickles), wet colors on a scene, and its list of members."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Int64

from ..safe_io.errors import SceneFormatError
from ..safe_io.files import whole_file
from ..safe_io.numpy_files import read_archive
from ..safe_io.text_files import printable_line
from ..scene.gaussians import Gaussians
from ..scene.scene import DrawItem, Layer, Scene

_VERSION = 1


def write_recolored(path: Path, colors: Mapping[str, Float32[np.ndarray, "_ _ 3"]]) -> None:
    """Write harmonics by name (`layers/NAME`, `actors/ID`) atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {"version": np.array(_VERSION), "names": np.array(list(colors), dtype=np.str_)}
    arrays |= {f"sh_{i}": sh for i, sh in enumerate(colors.values())}
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def read_recolored(path: Path | str) -> dict[str, Float32[np.ndarray, "_ _ 3"]]:
    """Read harmonics by name (`layers/NAME`, `actors/ID`); raises `SceneFormatError` if the file has other content."""
    try:
        file = read_archive(Path(path))
        version = int(file["version"])
        if version > _VERSION:
            raise SceneFormatError(path, f"version {version} is newer than {_VERSION}, which this program knows")
        colors = {str(name): file[f"sh_{i}"] for i, name in enumerate(file["names"])}
    except SceneFormatError:
        raise
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise SceneFormatError(path, f"not a file of recolored Gaussians: {printable_line(error)}") from None
    for name, sh in colors.items():
        if sh.dtype != np.float32 or sh.ndim != 3 or sh.shape[2] != 3:
            raise SceneFormatError(path, f"harmonics of {name!r} are {sh.dtype} {sh.shape}, expected float32 (n, k, 3)")
    return colors


# Wet colors on a scene


def with_colors(scene: Scene, colors: Mapping[str, Float32[np.ndarray, "_ _ 3"]]) -> Scene:
    """Return the scene with wet colors by key: of all Gaussians of a member, or of those not deleted, as in files.

    It gets a map of its water, too, if it has none and ground is found.
    """
    from ..appearance.wet_look.water_map import with_water_map  # loads slow parts of scipy

    for key, sh in colors.items():
        member = scene.member(key)
        deleted = member.marks.deleted
        if deleted is not None and len(sh) < len(member.gaussians):
            whole = member.gaussians.sh.copy()
            whole[(~deleted).indices] = sh
            sh = whole
        scene = scene.with_member(key, wet_sh=sh)
    return with_water_map(scene)


# Members with colors, as one list of Gaussians with consecutive rows


@dataclass(frozen=True, slots=True, eq=False)
class RecolorMember:
    """A layer or an actor."""

    key: str
    """`layers/NAME` or `actors/ID`."""
    gaussians: Gaussians
    is_sky: bool
    first: int
    """Row of its first Gaussian among those of all members."""

    @property
    def rows(self) -> slice:
        return slice(self.first, self.first + len(self.gaussians))


def scene_members(scene: Scene) -> list[RecolorMember]:
    """Layers first, then actors, in the scene's order, including hidden ones."""
    members: list[RecolorMember] = []
    first = 0
    for each in scene.members:
        is_sky = isinstance(each, Layer) and each.kind == "sky"
        members.append(RecolorMember(each.key, each.gaussians, is_sky, first))
        first += len(each.gaussians)
    return members


@dataclass(frozen=True, slots=True, eq=False)
class VisibleMembers:
    """The members present in the scene at one time, ready to render."""

    members: list[RecolorMember]
    parts: list[DrawItem]
    rows: Int64[np.ndarray, " n"]
    """Row among all members of each Gaussian of `parts`, in order."""
    is_sky: Bool[np.ndarray, " n"]


def visible_members(scene: Scene, members: list[RecolorMember], time_s: float) -> VisibleMembers:
    """Select the members visible at a time, with their transforms; grading applies after the solved colors."""
    placed = [
        (member, part._replace(colors=None))
        for member, placed in zip(members, scene.members, strict=True)
        if placed.visible and (part := scene.part(placed, time_s)) is not None
    ]
    none = np.zeros(0, np.int64)
    return VisibleMembers(
        [member for member, _ in placed],
        [part for _, part in placed],
        np.concatenate([none, *(np.arange(len(member.gaussians)) + member.first for member, _ in placed)]),
        np.concatenate([none > 0, *(np.full(len(member.gaussians), member.is_sky) for member, _ in placed)]),
    )


def world_heights(scene: Scene, member: RecolorMember) -> Float32[np.ndarray, " n"]:
    """World z of a layer's Gaussians in meters; for an actor, height above its own bottom."""
    placed = scene.member(member.key)
    if isinstance(placed, Layer):
        to_world = scene.scene_to_world @ placed.to_scene
        up, offset = to_world[2, :3], to_world[2, 3]
    else:
        up, offset = np.array([0, 0, scene.metres_per_unit]), 0.0
    return (member.gaussians.means @ up + offset).astype(np.float32)
