"""Results of jobs as steps of the document."""

import secrets
from collections.abc import Callable

from ..scene.scene import Scene
from .viewport_state import PendingScene, ViewportState


def scene_results(viewport: ViewportState, label: str, *, is_whole: bool = False) -> Callable[[Scene, bool], None]:
    """Create a receiver of a job's scenes, which makes its snapshots and its result one undo step.

    With `is_whole`, they replace the present scene; otherwise only their wet colors are used.
    """
    gesture, has_shown = f"job {secrets.token_hex(8)}", False

    def stage(scene: Scene, is_final: bool) -> None:
        nonlocal has_shown
        if viewport.is_opening or (viewport.staged is not None and not is_final):
            return  # it would replace the scene that is being opened, or a snapshot that is still being uploaded
        goes_on, has_shown = has_shown and not is_final, True
        viewport.staged = PendingScene(
            label, scene, is_whole=is_whole, only_wet_colors=not is_whole, gesture=gesture, goes_on=goes_on
        )

    return stage
