"""`gsrain [SCENE]`: the window."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from .display import has_display

if TYPE_CHECKING:
    from gsrain_engine.session.session import Session


def view(
    scene: Annotated[str | None, Parameter(help="Scene file or folder; without one, the built-in street.")] = None,
    /,
    *,
    preset: Annotated[
        str | None, Parameter(help="Rain preset (clear, 1.2, 8.5, 12.0, paper) or a preset file.")
    ] = None,
    wet: Annotated[bool, Parameter(help="Begin by making the scene rainy, as its panel does.", negative="")] = False,
    backend: Annotated[
        Literal["auto", "opengl", "cpu"], Parameter(help="auto takes OpenGL on a GPU, else the processor.")
    ] = "auto",
) -> None:
    """Open a scene in the window."""
    if scene not in (None, "street") and not Path(str(scene)).exists():
        from gsrain_engine.scene.open_scene import open_scene

        open_scene(scene)  # says what may have been meant
    if not has_display():
        raise OSError("no display: the window can't open here; gsrain render writes pictures and videos without one")
    from app.window import run_window  # the GUI libraries load only for the window

    def begin() -> "Session":
        from app.workspace import begin_session  # and the engine behind the window
        from gsrain_engine.rain.presets import load_preset

        return begin_session(scene, load_preset(preset) if preset else None, wet)

    run_window(begin, backend)
