"""Options and helpers about scenes: orientation, units, flagged Gaussians, and speed of camera paths."""

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


@Parameter(name="*")  # fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class Orientation:
    """Options about axes and units, which Gaussian files don't store."""

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
        """Return the scene in the chosen orientation; rotating it drops its ground height."""
        return oriented(scene, self.up, self.metres_per_unit)


# Scene or capture


def names_scene(name: str) -> bool:
    """Return True if a name is that of a scene; ambiguous folders, such as scene.json with images, count as scenes."""
    path = Path(name)
    return (
        is_built_in_street(name)
        or scene_folder_of(path) is not None
        or format_of(path) is not None
        or is_sog_folder(path)
    )


# Deleted and hidden Gaussians


def count_flagged(members: Sequence[Layer | Actor]) -> dict[str, int]:
    """Count deleted Gaussians, and hidden ones that are not deleted."""
    deleted = hidden = 0
    for member in members:
        marks = member.marks
        deleted += marks.deleted.size if marks.deleted is not None else 0
        if marks.hidden is not None:
            hidden += (marks.hidden if marks.deleted is None else marks.hidden - marks.deleted).size
    return {"deleted": deleted, "hidden": hidden}


def flagged_text(counts: dict[str, int]) -> str:
    """Return the counts in parentheses, or "" if all are zero."""
    said = [f"{count:,} {kind}" for kind, count in counts.items() if count]
    return f" ({', '.join(said)})" if said else ""


# Speed of a camera path

_LOWEST, _HIGHEST = 1e-3, 1e3


@dataclass(frozen=True, slots=True)
class TimedPath:
    """A camera path with its speed."""

    path: CameraPath
    line: str | None
    """One line for people, if the speed is not the path's own."""
    speed_m_s: float | None
    """None if the path has its own times."""
    is_assumed: bool


def timed_path(
    path: CameraPath, speed_m_s: float | None, metres_per_unit: float = 1.0, *, is_still: bool = False
) -> TimedPath:
    """Time a path at the given speed, by its own times, or at walking pace; in a still the latter camera is at rest.

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
