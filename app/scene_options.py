"""How a scene lies in the world, as a person says it: which way is up, how long a metre is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from gsrain_engine.editor.edits.level import UNIT_M, Axis, oriented
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_edit import WALKING_M_S, with_constant_speed
from gsrain_engine.scene.formats.registry import format_of
from gsrain_engine.scene.formats.sog import is_sog_folder
from gsrain_engine.scene.open import is_built_in_street, scene_folder_of
from gsrain_engine.scene.scene import Actor, Layer, Scene


@Parameter(name="*")  # its fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class Orientation:
    """Options about axes and units; files of Gaussians say neither."""

    up: Annotated[
        Axis | None,
        Parameter(
            help="Which way is up in the scene's axes; files of Gaussians alone are taken as -y.",
            allow_leading_hyphen=True,
        ),
    ] = None
    metres_per_unit: Annotated[float | None, Parameter(help="Length of one scene unit in metres.")] = None

    def __post_init__(self) -> None:
        if self.metres_per_unit is not None and not UNIT_M[0] <= self.metres_per_unit <= UNIT_M[1]:
            raise ValueError(f"--metres-per-unit {self.metres_per_unit:g}: must be within 0.000001..1000000")

    def of(self, scene: Scene) -> Scene:
        """Return the scene as it is said to lie; turned, it no longer knows the height of its ground."""
        return oriented(scene, self.up, self.metres_per_unit)


# § What a person names on the command line: a scene, or a capture.


def names_scene(name: str) -> bool:
    """Whether a name is that of a scene: what could be both, such as a folder with scene.json and pictures, is one."""
    path = Path(name)
    return (
        is_built_in_street(name)
        or scene_folder_of(path) is not None
        or format_of(path) is not None
        or is_sog_folder(path)
    )


# § How many Gaussians of a scene are marked, for commands that count them.


def count_flagged(members: Sequence[Layer | Actor]) -> dict[str, int]:
    """Count what is deleted, and what is hidden but not deleted."""
    deleted = hidden = 0
    for member in members:
        marks = member.marks
        deleted += marks.deleted.size if marks.deleted is not None else 0
        if marks.hidden is not None:
            hidden += (marks.hidden if marks.deleted is None else marks.hidden - marks.deleted).size
    return {"deleted": deleted, "hidden": hidden}


def flagged_text(counts: dict[str, int]) -> str:
    """Say so behind a number of Gaussians; nothing where none is marked."""
    said = [f"{count:,} {kind}" for kind, count in counts.items() if count]
    return f" ({', '.join(said)})" if said else ""


# § The speed of a camera path: as its file says, as a person asks, or, for photos without times, as one walks.

_LOWEST, _HIGHEST = 1e-3, 1e3


@dataclass(frozen=True, slots=True)
class TimedPath:
    """A path as it is flown."""

    path: CameraPath
    line: str | None
    """One line for people, where the speed is not the path's own."""
    speed_m_s: float | None
    """None where the path has times of its own."""
    is_assumed: bool


def timed_path(
    path: CameraPath, speed_m_s: float | None, metres_per_unit: float = 1.0, *, is_still: bool = False
) -> TimedPath:
    """Time a path: at the speed asked for, by its own times, or at walking pace; of that, a still is at rest.

    Raises ValueError, which names the option, for a speed out of bounds.
    """
    if speed_m_s is not None:
        if not _LOWEST <= speed_m_s <= _HIGHEST:
            raise ValueError(f"--speed {speed_m_s:g}: must be within {_LOWEST:g}..{_HIGHEST:g} m/s")
        return TimedPath(with_constant_speed(path, speed_m_s / metres_per_unit, is_timed=True), None, speed_m_s, False)
    if path.is_timed:
        return TimedPath(path, None, None, False)
    walked = with_constant_speed(path, WALKING_M_S / metres_per_unit)
    if is_still:
        line = "photos without times: the camera is at rest (--speed M_S lets it move)"
        return TimedPath(walked, line, 0.0, True)
    line = f"photos without times: walking pace, {WALKING_M_S:g} m/s, is assumed (--speed M_S says otherwise)"
    return TimedPath(replace(walked, is_timed=True), line, WALKING_M_S, True)
