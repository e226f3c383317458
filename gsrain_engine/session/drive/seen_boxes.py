"""What a camera agent has seen in a step, as boxes in the picture: from the notes of its roll-out."""

from typing import Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta

from gsrain_engine.drive.rollouts.rollout import RolloutStep
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import RigCamera

_LEAST_CONFIDENCE = 0.25
_Box = tuple[float, float, float, float]


class SeenBox(NamedTuple):
    """A detection; pixels of the viewport's picture."""

    low_px: tuple[float, float]
    high_px: tuple[float, float]
    words: str
    is_lead: bool
    """Whether the agent follows it."""


class _Detection(msgspec.Struct, frozen=True):
    box_xyxy: _Box
    confidence: Annotated[float, Meta(ge=0, le=1)] = 1.0
    class_name: str = msgspec.field(default="", name="class")


class _Lead(msgspec.Struct, frozen=True):
    box_xyxy: _Box | None = None
    gap_m: float | None = None


class _Notes(msgspec.Struct, frozen=True):
    detections: tuple[_Detection, ...] = ()
    lead: _Lead | None = None


def seen_boxes(step: RolloutStep, front: RigCamera, camera: Camera) -> list[SeenBox]:
    """Return the detections of a step for a camera that stands where the rig's front camera is.

    Empty where the agent has noted none, or notes something else by that name.
    """
    notes = _read(step.notes)
    found: list[SeenBox] = []
    for each in notes.detections:
        is_lead = notes.lead is not None and notes.lead.box_xyxy == each.box_xyxy
        if each.confidence < _LEAST_CONFIDENCE and not is_lead:
            continue
        x0, y0, x1, y1 = each.box_xyxy
        words = f"{each.class_name} {each.confidence:.2f}".strip()
        if is_lead and notes.lead is not None and notes.lead.gap_m is not None:
            words += f", {notes.lead.gap_m:.1f} m"
        found.append(SeenBox(_moved(x0, y0, front, camera), _moved(x1, y1, front, camera), words, is_lead))
    return found


def _read(notes: dict[str, Any]) -> _Notes:
    try:
        return msgspec.convert(notes, _Notes)
    except msgspec.ValidationError:
        return _Notes()


def _moved(x: float, y: float, front: RigCamera, camera: Camera) -> tuple[float, float]:
    """A pixel of the rig's camera as a pixel of another one at the same place."""
    right, down = (x - front.cx) / front.fx, (y - front.cy) / front.fy
    return camera.fx * right + camera.cx, camera.fy * down + camera.cy
