"""Edits of a scene that take a while: entry points `gsrain.scene_edits`, as steps and as background jobs."""

from collections.abc import Callable, Generator
from dataclasses import dataclass, field, fields, replace
from functools import cache, wraps
from inspect import Parameter, signature
from typing import Any, TypeVar, get_type_hints

from ..plugins import SCENE_EDITS, Extension, load_extensions, warn_once
from ..scene.progress import Progress, run_to_end
from ..scene.scene import Actor, Layer, Scene
from .document import Document, Recipe
from .edits.members import replace_scene, with_members
from .jobs.job import Job, JobRunner

_Value = TypeVar("_Value", bound=Scene | Layer | Actor)


@dataclass(frozen=True, eq=False)
class SceneEdit:
    """An edit of a scene by a package; the name of its entry point is its name in `gsrain edit` and `gr.edit`.

    Raises ValueError for a function whose parameters after the first have no type or no default.
    """

    title: str
    """Name of its command in the window and of its step in the history, unique and starting with a verb."""
    summary: str
    """One sentence that says what it does."""
    work: Callable[..., Generator[Progress, None, Scene]]
    """Gets the scene and returns another one, without changing arrays in place; yields its progress.

    Its further parameters have types that JSON values can be converted to. The window runs it with their defaults, in a
    thread. It raises ValueError with one sentence where it refuses a scene.
    """
    is_possible: Callable[[Scene], bool] = lambda scene: scene.gaussian_count > 0
    """Returns whether a scene can be edited, in microseconds: the window asks in each frame of its menu."""

    def __post_init__(self) -> None:
        types = get_type_hints(self.work)
        for each in list(signature(self.work).parameters.values())[1:]:
            if each.name not in types or each.default is Parameter.empty:
                raise ValueError(f"edit {self.title!r}: its parameter {each.name} needs a type and a default")


@dataclass(frozen=True)
class InstalledEdit:
    """An edit of an installed package."""

    name: str
    declared: SceneEdit
    extension: Extension = field(compare=False)

    @property
    def function(self) -> Callable[..., Scene]:
        """The edit as a function of a scene and its parameters that returns when it is done."""
        return _function_of(self)

    def run(self, scene: Scene, **arguments: Any) -> Generator[Progress, None, Scene]:
        """Edit a scene. Raises ValueError where the edit refuses it, `ExtensionError` where it fails."""
        try:
            made = yield from self.declared.work(scene, **arguments)
        except ValueError:
            raise
        except Exception as error:  # third-party code may raise anything
            raise self.extension.unfit(error) from error
        return self.extension.expect(made, Scene, "returns")

    def is_possible(self, scene: Scene) -> bool:
        """Return whether a scene can be edited; an error counts as no, and is logged once."""
        try:
            return bool(self.declared.is_possible(scene))
        except Exception as error:  # third-party code may raise anything
            warn_once(str(self.extension.unfit(error)))
            return False


@cache
def _function_of(edit: InstalledEdit) -> Callable[..., Scene]:
    """Return the same function for the same edit: the history finds the edit's name by it."""

    @wraps(edit.declared.work)
    def function(scene: Scene, **arguments: Any) -> Scene:
        return run_to_end(edit.run(scene, **arguments))

    function.__doc__ = edit.declared.summary
    return function


def installed_edits() -> list[InstalledEdit]:
    """All edits of installed packages that can be used."""
    found = load_extensions(SCENE_EDITS, SceneEdit)
    return [InstalledEdit(each.name.replace("_", "-"), declared, each) for each, declared in found]


class SceneEdits:
    """Runs the edits of installed packages in the background, one at a time; the end of each is one undo step."""

    def __init__(self, document: Document, jobs: JobRunner) -> None:
        self._document, self._jobs = document, jobs

    def is_possible(self, edit: InstalledEdit) -> bool:
        """Return whether the present scene can be edited now."""
        return not self._jobs.is_running("scene edit") and edit.is_possible(self._document.scene)

    def start(self, edit: InstalledEdit) -> Job[Scene]:
        """Start an edit in a thread; the result is dropped if what it depends on changes meanwhile."""
        scene, title = self._document.scene, edit.declared.title

        def work() -> Generator[Progress, None, Scene]:
            return edit.run(scene)

        def take(made: Scene, _: bool) -> str:
            edited = _with_changes(scene, made, self._document.scene)
            if edited is None:
                return f"The scene has changed meanwhile: {title} once more"
            self._document.edit(title, replace_scene, edited, recipe=Recipe(edit.function, {}))
            return _differences(scene, made)

        job = Job("scene edit", title, work, in_thread=True, progress=Progress(0.0, "Starting"))
        return self._jobs.start(job, take)


def _differences(before: Scene, made: Scene) -> str:
    """Name the lamps and layers of an edited scene that are new, and where to find them; "" if none are."""
    names = {each.name for each in before.layers}
    added = " and ".join(each.name for each in made.layers if each.name not in names)
    count = len(made.lamps)
    lamps = f"{count} lamp{'s'[: count != 1]} (Rain panel, Lamps)" if made.lamps != before.lamps else ""
    layers = f"new in the Layers panel: {added}" if added else ""
    return "; ".join(filter(None, [lamps, layers]))


def _with_changes(before: Scene, made: Scene, now: Scene) -> Scene | None:
    """Return the scene as it is now with what an edit has changed in it as it was before.

    Locks, selection, camera path and the like may have changed meanwhile. None if geometry, colors, names or lamps
    have, or what the edit has changed, too; or if it has removed or added Gaussians of a member and anything has.
    """
    if now is before:
        return made
    earlier, present, later = ({each.key: each for each in scene.members} for scene in (before, now, made))
    if now.geometry_key != before.geometry_key or now.lamps != before.lamps or list(present) != list(earlier):
        return None
    if not all(key in later and len(later[key].gaussians) == len(each.gaussians) for key, each in earlier.items()):
        return None
    members = [_merged(earlier[key], each, present[key]) if key in earlier else each for key, each in later.items()]
    scene = _merged(before, replace(made, layers=before.layers, actors=before.actors), now)
    if scene is None or None in members:
        return None
    return with_members(scene, [each for each in members if each is not None])


def _merged(before: _Value, made: _Value, now: _Value) -> _Value | None:
    """Return the present value with the fields that an edit has changed; None if others have changed one of them."""
    changed = [each.name for each in fields(made) if getattr(made, each.name) is not getattr(before, each.name)]
    if any(getattr(now, name) is not getattr(before, name) for name in changed):
        return None
    return replace(now, **{name: getattr(made, name) for name in changed})
