"""What a detector should find in a picture: objects with a class, a box, and how well they can be seen."""

from dataclasses import dataclass

BoxXYXY = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels; the left edge of the first column is 0."""

LEAST_VISIBILITY = 0.25
LEAST_HEIGHT_PX = 16.0
"""Objects of less are hardly there for anybody: they are no misses, and who finds them is not wrong."""


@dataclass(frozen=True, slots=True)
class LabelledObject:
    """One object in one picture."""

    id: str
    """The same in every frame of a drive."""
    class_name: str
    """As COCO calls it, where COCO knows it; see `label_class`."""
    box_xyxy: BoxXYXY
    """What can be seen of it, cut at the picture's edges."""
    visibility: float = 1.0
    """Visible area over the area that it had if nothing stood in front of it; 0..1."""
    distance_m: float | None = None
    """From the camera to its middle; None where nobody knows."""
    is_ignored: bool = False
    """Such as a crowd: no miss when it is not found, no mistake when it is."""

    @property
    def height_px(self) -> float:
        return self.box_xyxy[3] - self.box_xyxy[1]

    @property
    def counts(self) -> bool:
        """Whether it is large and free enough to be asked for."""
        return not self.is_ignored and self.visibility >= LEAST_VISIBILITY and self.height_px >= LEAST_HEIGHT_PX
