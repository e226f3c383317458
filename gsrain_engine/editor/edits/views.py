"""Edits of the named views of a scene: save, rename, delete, reorder."""

from dataclasses import replace

from msgspec import structs

from ...scene.named_view import NamedView, check_views, view_named
from ...scene.scene import Scene


def save_view(scene: Scene, view: NamedView) -> Scene:
    """Save a named view, in place of one of that name, else as the last one."""
    if any(each.name == view.name for each in scene.views):
        return _with_views(scene, tuple(view if each.name == view.name else each for each in scene.views))
    return _with_views(scene, (*scene.views, view))


def rename_view(scene: Scene, name: str, other: str) -> Scene:
    """Rename a view. Raises `ValueError` if there is none, or if the other name is in use or not allowed."""
    view = view_named(scene.views, name, scene.name)
    if any(each.name == other and each is not view for each in scene.views):
        raise ValueError(f"The view keeps its name: there is a view named {other!r} already")
    renamed = structs.replace(view, name=other)
    return _with_views(scene, tuple(renamed if each is view else each for each in scene.views))


def remove_view(scene: Scene, name: str) -> Scene:
    """Delete a view. Raises `ValueError` if there is none."""
    view = view_named(scene.views, name, scene.name)
    return _with_views(scene, tuple(each for each in scene.views if each is not view))


def move_view(scene: Scene, name: str, to: int) -> Scene:
    """Move a view to a place in the list, which counts from 0. Raises `ValueError` if there is none."""
    view = view_named(scene.views, name, scene.name)
    others = [each for each in scene.views if each is not view]
    others.insert(min(max(to, 0), len(others)), view)
    return scene if tuple(others) == scene.views else _with_views(scene, tuple(others))


def _with_views(scene: Scene, views: tuple[NamedView, ...]) -> Scene:
    check_views(views)
    return replace(scene, views=views)
