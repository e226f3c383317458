"""The program in a process of its own, whose graphics card is lost on purpose: SCENE LOSSES [raise] [unchanged].

The driver's answer is all that is made up. Each process says what it shows; those after LOSSES end as a person would.
With `raise` the driver fails in the middle of a frame instead.
"""

import os
import sys

import glfw
import moderngl
from imgui_bundle import glfw_utils

from app.main import run
from gsrain_engine.render.opengl.context import context_monitor
from ui.workspace import Workspace

_INNOCENT_CONTEXT_RESET = 0x8254
_SCENE, _LOSSES, *_HOW = sys.argv[1:]
_TIMES = int(os.environ.get("GSRAIN_RESTARTS", "0"))


class _Acting(Workspace):
    """A workspace that edits the first scene it has, and then loses its graphics card."""

    acted = False

    def update(self) -> None:
        """Act once, as soon as there is a scene."""
        super().update()
        editor = self.editor
        if self.acted or not editor.document.scene.members or editor.viewport.is_opening:
            return
        self.acted = True
        robustness = glfw.get_window_attrib(glfw_utils.glfw_window_hello_imgui(), glfw.CONTEXT_ROBUSTNESS)
        asked = editor.status.question
        document, has_changes = editor.document, editor.files.has_changes
        print(
            f"{_TIMES}: {document.scene.name} at {document.rain.intensity_mm_h} mm/h, changed: {has_changes},",
            f"tells of resets: {robustness == glfw.LOSE_CONTEXT_ON_RESET}, says: {editor.status.problem},",
            f"asks: {asked and asked.title}",
            flush=True,
        )
        if int(_LOSSES) <= _TIMES:
            editor.files.give_up()
            editor.request_quit()
        elif not (editor.files.has_changes or "unchanged" in _HOW):
            editor.document.change_rain("Change the intensity", intensity_mm_h=77.0)
        if int(_LOSSES) > _TIMES and "raise" not in _HOW:
            lose(self.context)

    def draw_viewport(self) -> None:
        """Draw; or fail as a driver does."""
        super().draw_viewport()
        if self.acted and "raise" in _HOW:
            raise moderngl.Error("cannot create texture")


def lose(context: moderngl.Context) -> None:
    """Let the driver say that it restarts, as often as it is asked for a second; then that all is well."""
    watcher, answers = context_monitor(context), iter([_INNOCENT_CONTEXT_RESET] * 20)
    assert watcher is not None and watcher.ask() == 0
    watcher.ask = lambda: next(answers, 0)


def main() -> int:
    """Run the program; a context of EGL tells of resets on llvmpipe too, one of GLX does not there."""
    glfw.init()
    glfw.window_hint(glfw.CONTEXT_CREATION_API, glfw.EGL_CONTEXT_API)
    sys.modules["ui.workspace"].Workspace = _Acting  # type: ignore[misc]
    return run([_SCENE, "--backend", "opengl"])


if __name__ == "__main__":
    sys.exit(main())
