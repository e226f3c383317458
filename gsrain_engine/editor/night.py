"""The night look of the open scene, as a job whose end is one undo step."""

from collections.abc import Generator
from dataclasses import replace
from typing import TypeVar

from ..scene.progress import Progress
from ..scene.scene import Actor, Layer, Scene
from .background_edits import relight_by_night
from .document import Document, Recipe
from .edits.members import replace_scene
from .jobs.job import Job, JobRunner

NIGHT_TITLE = "Relight for night"
Member = TypeVar("Member", Layer, Actor)


class NightLook:
    """The job that relights the scene by its lamps."""

    def __init__(self, document: Document, jobs: JobRunner) -> None:
        self._document, self._jobs = document, jobs

    @property
    def is_possible(self) -> bool:
        """True if there is a scene, and no such job."""
        return self._document.scene.gaussian_count > 0 and not self._jobs.is_running("night")

    def relight(self) -> Job[Scene]:
        """Start to relight the scene in a thread; the result is dropped if its geometry or lamps change meanwhile."""
        scene = self._document.scene

        def work() -> Generator[Progress, None, Scene]:
            from ..appearance.night_look.night_gaussians import night_scene  # loads slow parts of scipy

            return (yield from night_scene(scene))

        def take(made: Scene, _: bool) -> str:
            relit = _with_light_of(made, scene, self._document.scene)
            if relit is None:
                return "The scene has changed meanwhile: relight it again"
            self._document.edit(NIGHT_TITLE, replace_scene, relit, recipe=Recipe(relight_by_night, {}))
            return _summary(relit, scene)

        progress = Progress(0.0, "Looking at the scene")
        return self._jobs.start(Job("night", NIGHT_TITLE, work, in_thread=True, progress=progress), take)


def _summary(relit: Scene, before: Scene) -> str:
    """Sentence about the lamps and the layers of a night, and where to find them."""
    count, names = len(relit.lamps), {each.name for each in before.layers}
    added = " and ".join(each.name for each in relit.layers if each.name not in names)
    layers = f"; new in the Layers panel: {added}" if added else ""
    return f"Lit by {count} lamp{'s'[: count != 1]} (Rain panel, Lamps){layers}"


def _with_light_of(night: Scene, before: Scene, now: Scene) -> Scene | None:
    """Return the scene as it is now with the light of `night`, which was made of it as it was before.

    Selection, camera path and the like may have changed meanwhile; None if what is lit, or its lamps, has.
    """
    if now is before:
        return night
    is_same = now.geometry_key == before.geometry_key and now.lamps == before.lamps
    if not is_same or [each.key for each in now.members] != [each.key for each in before.members]:
        return None

    def lit(member: Member) -> Member:
        made = night.member(member.key)
        return replace(member, gaussians=made.gaussians, wet_sh=made.wet_sh)

    layers, actors = map(lit, now.layers), map(lit, now.actors)
    added = night.layers[len(before.layers) :]
    return replace(now, layers=(*layers, *added), actors=tuple(actors), lamps=night.lamps, water=night.water)
