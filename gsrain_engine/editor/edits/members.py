"""Members of a scene in edits: access to editable ones, unique names, selection sets, new Gaussians."""

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import Any, TypedDict, Unpack

import msgspec

from ...scene.camera_path import CameraPath, Interpolation
from ...scene.camera_path_edit import EditedKeyframe
from ...scene.easing import Easing
from ...scene.flags import BitMask
from ...scene.scene import Actor, ColorGrading, Layer, Scene


def is_editable(member: Layer | Actor) -> bool:
    """Return whether selection and edits apply to a member: visible and not locked."""
    return member.visible and not member.locked


def find_member(scene: Scene, key: str) -> Layer | Actor:
    """Find a member; raises `ValueError` if there is none."""
    try:
        return scene.member(key)
    except KeyError:
        raise ValueError(f"There is no {key!r} in the scene.") from None


def find_unlocked_member(scene: Scene, key: str) -> Layer | Actor:
    """Find an unlocked member, visible or not; raises `ValueError` if there is none or it is locked."""
    member = find_member(scene, key)
    if member.locked:
        raise ValueError(f"{member.name} is locked.")
    return member


Keys = str | Sequence[str]
"""Key of a layer or actor, or several: a sequence, or a text with commas between them."""


def find_members(scene: Scene, keys: Keys) -> list[Layer | Actor]:
    """Find one member or several, in the order of the scene; keys that have gone are left out.

    Raises `ValueError` if there is none of them.
    """
    own = {each.key for each in scene.members}
    if isinstance(keys, str):
        wanted = {keys} if keys in own else {each.strip() for each in keys.split(",")}
    else:
        wanted = set(keys)
    found = [each for each in scene.members if each.key in wanted]
    if not found:
        raise ValueError(f"There is no {keys!r} in the scene.")
    return found


def keys_of(members: Sequence[Layer | Actor]) -> Keys:
    """Return the key of one member, or those of several."""
    return members[0].key if len(members) == 1 else tuple(each.key for each in members)


def members_title(members: Sequence[Layer | Actor]) -> str:
    """Name one member, or count several: "road", "3 layers", "2 layers and actors"; empty for none."""
    if len(members) < 2:
        return "".join(each.name for each in members)
    kinds = {Layer: "layers", Actor: "actors"}
    return f"{len(members)} {' and '.join(title for kind, title in kinds.items() if kind in map(type, members))}"


def with_members(scene: Scene, members: Iterable[Layer | Actor]) -> Scene:
    """Return the scene with other members; layers and actors each in their order."""
    members = tuple(members)
    return replace(
        scene,
        layers=tuple(each for each in members if isinstance(each, Layer)),
        actors=tuple(each for each in members if isinstance(each, Actor)),
    )


def edit_members(scene: Scene, edit: Callable[[Layer | Actor], Layer | Actor]) -> Scene:
    """Apply a function to every editable member; returns the same scene object if nothing changed."""
    members = tuple(edit(each) if is_editable(each) else each for each in scene.members)
    unchanged = all(new is old for new, old in zip(members, scene.members, strict=True))
    return scene if unchanged else with_members(scene, members)


def with_selections(scene: Scene, change: Callable[[Mapping[str, BitMask]], Mapping[str, BitMask]]) -> Scene:
    """Apply a function to each selection set of a scene."""
    return replace(scene, selections={name: change(masks) for name, masks in scene.selections.items()})


def insert_after(scene: Scene, key: str, added: Layer | Actor) -> Scene:
    at = next((i for i, each in enumerate(scene.members) if each.key == key), len(scene.members) - 1)
    return with_members(scene, (*scene.members[: at + 1], added, *scene.members[at + 1 :]))


def with_unique_name(scene: Scene, member: Layer | Actor, name: str | None = None) -> Layer | Actor:
    """Return a member under a name that no other of its kind has; with `name`, a member of the scene is renamed."""
    used = {each.name for each in scene.members if type(each) is type(member)}
    new = unique_name(member.name, used) if name is None else unique_name(name, used - {member.name})
    return replace(member, name=new) if isinstance(member, Layer) else replace(member, id=new)


def unique_name(name: str, used: Collection[str]) -> str:
    """Return `name`, with a number appended if it is in use: "road", "road 2", "road 3"."""
    if name not in used:
        return name
    stem = re.sub(r" \d+$", "", name) or name
    return next(each for number in count(2) if (each := f"{stem} {number}") not in used)


def replace_scene(scene: Scene, other: Scene) -> Scene:
    """Take another scene in place of a scene: the result of a job, or of another program."""
    return other


def set_path(scene: Scene, path: CameraPath | None) -> Scene:
    """Set the camera path, in scene units and axes; None removes it."""
    return replace(scene, path=path)


def with_path(
    scene: Scene, change: Callable[..., CameraPath | EditedKeyframe | None], *arguments: Any, **options: Any
) -> Scene:
    """Set the camera path that `change(path, *arguments, **options)` returns."""
    path = change(scene.path, *arguments, **options)
    return replace(scene, path=path.path if isinstance(path, EditedKeyframe) else path)


class PathOptions(TypedDict, total=False):
    """Options of a whole camera path; see `CameraPath`."""

    interpolation: Interpolation
    easing: Easing
    loop: bool


def change_path(path: CameraPath, **options: Unpack[PathOptions]) -> CameraPath:
    """Change interpolation, easing or loop of the camera path."""
    return replace(path, **options)


def set_opacity(scene: Scene, key: Keys, opacity: float) -> Scene:
    """Set the opacity (0..1) of layers and actors."""
    return _with_fields(scene, key, lambda _: {"opacity": opacity})


def set_grading(scene: Scene, key: Keys, grading: ColorGrading | None = None, **fields: float) -> Scene:
    """Set the color grading of layers and actors, or some of its fields."""
    return _with_fields(
        scene, key, lambda each: {"grading": msgspec.structs.replace(grading or each.grading, **fields)}
    )


def set_visible(scene: Scene, key: Keys, visible: bool) -> Scene:
    """Show or hide layers and actors."""
    return _with_fields(scene, key, lambda _: {"visible": visible})


def set_locked(scene: Scene, key: Keys, locked: bool) -> Scene:
    """Lock layers and actors against edits, or unlock them."""
    return _with_fields(scene, key, lambda _: {"locked": locked})


def _with_fields(scene: Scene, keys: Keys, fields: Callable[[Layer | Actor], Mapping[str, Any]]) -> Scene:
    for member in find_members(scene, keys):
        scene = scene.with_member(member.key, **fields(member))
    return scene
