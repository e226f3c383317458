"""Results of jobs as steps of the document."""

import secrets
from collections.abc import Callable

from ..scene.scene import Scene
from ..scene.transforms import with_wet_colors_of
from .document import Recipe
from .edits.members import replace_scene
from .viewport_state import PendingScene, ViewportState


def scene_results(
    viewport: ViewportState, label: str, recipe: Recipe, *, is_whole: bool = False
) -> Callable[[Scene, bool], str | None]:
    """Create a receiver of a job's scenes, which makes its snapshots and its result one undo step.

    With `is_whole`, they replace the present scene, and belong to no folder; otherwise only their wet colors are used,
    while the document is of the scene for which the job was started.
    """
    gesture, has_shown = f"job {secrets.token_hex(8)}", False
    document = viewport.document
    origin = document.state.origin

    def stage(scene: Scene, is_final: bool) -> str | None:
        nonlocal has_shown
        if not is_whole and document.state.origin != origin:
            return f"{scene.name}, for which this was started, is not open any more: its colors are left out"
        if viewport.is_opening or (viewport.staged is not None and not is_final):
            return None  # it would replace the scene that is being opened, or a snapshot that is still being uploaded
        goes_on, has_shown = has_shown and not is_final, True
        change = replace_scene if is_whole else with_wet_colors_of
        viewport.staged = PendingScene(label, scene, change=change, recipe=recipe, gesture=gesture, goes_on=goes_on)
        return None

    return stage
