"""Selection commands, each a labeled undo step; selection sets; and the options of the selection tools."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from ...scene.scene import Scene
from ..document import Document
from ..edits.gaussians import CropBox
from ..edits.members import unique_name
from ..timeline import Playback
from . import candidates
from .attributes import AttributeHistogram
from .candidates import Found, Mode
from .screen import DepthMode, Depths
from .volume import Sphere, near_selection

_DISTANCE_SHARE = 1 / 200  # of the distance of the orbit's pivot: 0.1 m in a street


@dataclass(slots=True, eq=False)
class SelectionTool:
    """Options of the selection tools, which are not part of the document, and the commands that select."""

    document: Document
    playback: Playback
    mode: Mode = "set"
    """Mode without a modifier key."""
    depths: Depths = "all through"
    depth_m: float = 20.0
    touching: bool = False
    brush_radius_px: float = 24.0
    tolerance: float = 0.1
    """Color tolerance of the flood and color tools, 0..1."""
    flood_reach: float = 2.0
    """In spacings of the Gaussians."""
    distance_m: float = 0.1
    """Distance to grow and shrink by, and `depth_m` follow the size of the scene at first, see `fit`."""
    attribute: str = "opacity"
    range: tuple[float, float] | None = None
    """Range of the attribute, in its unit; None until the user has chosen one."""
    set_name: str = ""
    """Name of the next selection set; empty for a numbered one."""
    renamed_set: str = ""
    """Set being renamed; empty for none."""
    new_name: str = ""
    ball: Sphere | None = None
    """Sphere that is placed but not yet applied."""
    box: CropBox | None = None
    """Box that is placed but not yet applied."""
    histogram: AttributeHistogram = field(default_factory=AttributeHistogram)

    def fit(self, pivot_m: float) -> None:
        """Begin in another scene, with lengths that fit its size; `pivot_m` is the distance of the orbit's pivot."""
        self.ball = self.box = None
        self.depth_m, self.distance_m = (float(f"{share * pivot_m:.1g}") for share in (1.0, _DISTANCE_SHARE))

    @property
    def reach(self) -> DepthMode:
        """Depth reach of shapes drawn in the image."""
        return DepthMode(self.depths, self.depth_m, self.touching)

    @property
    def is_empty(self) -> bool:
        return not candidates.selections(self.document.scene)

    def select(self, mode: Mode, by: str, find: Callable[..., Found], *arguments: Any) -> None:
        """Combine what `find(scene, *arguments)` returns with the selection. `by` ends the step's label."""

        def label(before: Scene, after: Scene) -> str:
            now, then = candidates.selected_count(after), candidates.selected_count(before)
            return {
                "set": f"Select {now:,} by {by}" if now else f"Select none by {by}",
                "add": f"Add {now - then:,} by {by}",
                "remove": f"Remove {then - now:,} by {by}",
                "intersect": f"Keep {now:,} by {by}",
            }[mode]

        self.document.edit(label, select_found, mode, find, *arguments)

    def select_all(self) -> None:
        self.document.edit(_counted("Select all {:,}"), candidates.all_selected)

    def select_none(self) -> None:
        self.document.edit("Select none", candidates.none_selected)

    def invert(self) -> None:
        self.document.edit(_counted("Invert selection to {:,}"), candidates.inverted)

    def grow(self) -> None:
        """Add Gaussians within the chosen distance of the selection."""
        label = _counted(f"Grow selection by {self.distance_m:.3g} m to {{:,}}")
        time_s = self.playback.clock.time_s
        self.document.edit(label, select_found, "add", near_selection, time_s, self.distance_m)

    def shrink(self) -> None:
        """Deselect Gaussians within the chosen distance of unselected ones."""
        label = _counted(f"Shrink selection by {self.distance_m:.3g} m to {{:,}}")
        time_s = self.playback.clock.time_s
        self.document.edit(label, select_found, "remove", near_selection, time_s, self.distance_m, True)

    # Selection sets

    def save_set(self) -> bool:
        """Save the selection as a set under the typed name, or an unused one; return whether it was saved."""
        name = self.set_name.strip() or unused_set_name(self.document.scene)
        return self.document.edit(f"Save set {name}", save_set, name)

    def recall_set(self, name: str, mode: Mode) -> None:
        """Combine a set with the selection."""
        self.select(mode, f"set {name}", members_of_set, name)

    def rename_set(self, name: str, other: str) -> None:
        if other.strip() != name:
            self.document.edit(f"Rename set {name} to {other.strip()}", rename_set, name, other.strip())

    def remove_set(self, name: str) -> None:
        """Delete a set; the selection is unchanged."""
        self.document.edit(f"Delete set {name}", remove_set, name)


def _counted(label: str) -> Callable[[Scene, Scene], str]:
    """Label with the number of selected Gaussians."""
    return lambda _, after: label.format(candidates.selected_count(after))


# Edits


def select_found(scene: Scene, mode: Mode, find: Callable[..., Found], *arguments: Any, **options: Any) -> Scene:
    """Combine the Gaussians that `find(scene, *arguments, **options)` returns with the selection."""
    return candidates.combine_selection(scene, find(scene, *arguments, **options), mode)


def unused_set_name(scene: Scene) -> str:
    return unique_name("selection 1", scene.selections)


def save_set(scene: Scene, name: str) -> Scene:
    """Save the selection as a set, in place of one of that name; raises `ValueError` if nothing is selected."""
    now = candidates.selections(scene)
    if not now:
        raise ValueError("The selection set is not saved: nothing is selected that a selection set could keep")
    return replace(scene, selections={**scene.selections, name: now})


def members_of_set(scene: Scene, name: str) -> Found:
    """Gaussians of a set, without members that are gone or whose number of Gaussians has changed."""
    counts = {member.key: len(member.gaussians) for member in scene.members}
    return {key: mask for key, mask in scene.selections[name].items() if counts.get(key) == mask.count}


def rename_set(scene: Scene, name: str, other: str) -> Scene:
    """Rename a set in its place; raises `ValueError` without a name, or if it is in use."""
    if not other or other in scene.selections:
        trouble = f"there is a selection set named {other!r} already" if other else "a selection set needs a name"
        raise ValueError(f"The selection set keeps its name: {trouble}")
    return replace(scene, selections={other if each == name else each: own for each, own in scene.selections.items()})


def remove_set(scene: Scene, name: str) -> Scene:
    """Delete a selection set; the selection stays."""
    return replace(scene, selections={each: own for each, own in scene.selections.items() if each != name})
