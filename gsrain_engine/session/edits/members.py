"""What edits of members have in common: who may be edited, and what follows a member that gets another key."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import Actor, Layer
from gsrain_engine.scene.scene import Scene

Members = tuple[Layer | Actor, ...]


def is_editable(member: Layer | Actor) -> bool:
    """Whether selection and edits take it: it can be seen and is not locked."""
    return member.visible and not member.locked


def found(scene: Scene, key: str) -> Layer | Actor:
    """Find a member; raises `ValueError` where there is none."""
    try:
        return scene.member(key)
    except KeyError:
        raise ValueError(f"There is no {key!r} in the scene.") from None


def unlocked(scene: Scene, key: str) -> Layer | Actor:
    """Find a member that may be edited, visible or not; raises `ValueError` where there is none or it is locked."""
    member = found(scene, key)
    if member.locked:
        raise ValueError(f"{member.name} is locked.")
    return member


def with_members(scene: Scene, members: Members) -> Scene:
    """Return the scene with other members; layers and actors each stay in the order given."""
    return replace(
        scene,
        layers=tuple(each for each in members if isinstance(each, Layer)),
        actors=tuple(each for each in members if isinstance(each, Actor)),
    )


def edited(scene: Scene, edit: Callable[[Layer | Actor], Layer | Actor]) -> Scene:
    """Let every member that may be edited go through a function; the very same scene where nothing changed."""
    members = tuple(edit(each) if is_editable(each) else each for each in scene.members)
    unchanged = all(new is old for new, old in zip(members, scene.members, strict=True))
    return scene if unchanged else with_members(scene, members)


def with_selections(scene: Scene, change: Callable[[Mapping[str, Mask]], Mapping[str, Mask]]) -> Scene:
    """Let each selection set of a scene go through a function."""
    return replace(scene, selections={name: change(masks) for name, masks in scene.selections.items()})


def named(member: Layer | Actor, name: str) -> Layer | Actor:
    return replace(member, name=name) if isinstance(member, Layer) else replace(member, id=name)


def names(scene: Scene, like: Layer | Actor) -> set[str]:
    return {each.name for each in scene.members if type(each) is type(like)}


def behind(scene: Scene, key: str, added: Members) -> Members:
    at = next((i for i, each in enumerate(scene.members) if each.key == key), len(scene.members) - 1)
    return (*scene.members[: at + 1], *added, *scene.members[at + 1 :])
