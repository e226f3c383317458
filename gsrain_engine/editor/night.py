"""The night look of the open scene, as a job whose end is one undo step."""

from collections.abc import Iterator

from ..scene.progress import Progress
from ..scene.scene import Scene
from .background_edits import relight_by_night
from .document import Document, Recipe
from .edits.members import replace_scene
from .jobs.job import Job, JobRunner, no_result

NIGHT_TITLE = "Relight for night"


class NightLook:
    """The job that relights the scene by its lamps."""

    def __init__(self, document: Document, jobs: JobRunner) -> None:
        self._document, self._jobs = document, jobs

    @property
    def is_possible(self) -> bool:
        """True if there is a scene, and no such job."""
        return self._document.scene.gaussian_count > 0 and not self._jobs.is_running("night")

    def relight(self) -> Job[None]:
        """Start to relight the scene in a thread; the result is dropped if the scene changes meanwhile."""
        scene, made = self._document.scene, list[Scene]()

        def work() -> Iterator[Progress]:
            from ..appearance.night_look.night_gaussians import night_scene  # loads slow parts of scipy

            made.append((yield from night_scene(scene)))

        def take(_: None, __: bool) -> str:
            if self._document.scene is not scene:
                return "The scene has changed meanwhile: relight it again"
            self._document.edit(NIGHT_TITLE, replace_scene, made[0], recipe=Recipe(relight_by_night, {}))
            count = len(made[0].lamps)
            return f"Lit by {count} lamp{'s'[: count != 1]}"

        progress = Progress(0.0, "Looking at the scene")
        return self._jobs.start(Job("night", NIGHT_TITLE, work, no_result, in_thread=True, progress=progress), take)
