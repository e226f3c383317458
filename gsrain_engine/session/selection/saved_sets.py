"""Selection sets: selections that the scene keeps under a name."""

from dataclasses import replace

from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.scene import Scene

from .combine import selections


def saved(scene: Scene, name: str) -> Scene:
    """Keep what is selected under a name; a set of that name is replaced.

    Raises `ValueError` where the name is empty or nothing is selected.
    """
    now = selections(scene)
    if not now:
        raise ValueError("nothing is selected that a selection set could keep")
    return replace(scene, selections={**scene.selections, _checked(name): now})


def found_in_set(scene: Scene, name: str) -> dict[str, Mask]:
    """Find the Gaussians of a set; members that are gone, or have other Gaussians now, are passed by."""
    counts = {member.key: len(member.gaussians) for member in scene.members}
    return {key: mask for key, mask in scene.selections[name].items() if counts.get(key) == mask.count}


def renamed(scene: Scene, name: str, other: str) -> Scene:
    """Call a set otherwise; it keeps its place. Raises `ValueError` where the name is empty or taken."""
    other = _checked(other)
    if other != name and other in scene.selections:
        raise ValueError(f"there is a selection set named {other!r} already")
    return replace(scene, selections={other if each == name else each: own for each, own in scene.selections.items()})


def removed(scene: Scene, name: str) -> Scene:
    """Forget a set; what is selected stays."""
    return replace(scene, selections={each: own for each, own in scene.selections.items() if each != name})


def free_name(scene: Scene) -> str:
    """Return a name that no set has."""
    number = 1
    while f"selection {number}" in scene.selections:
        number += 1
    return f"selection {number}"


def _checked(name: str) -> str:
    if not name.strip():
        raise ValueError("a selection set needs a name")
    return name.strip()
