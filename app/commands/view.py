"""`gsrain [SCENE]`: the window."""

from typing import Annotated

from cyclopts import Parameter

from gsrain_engine.rain.presets import load_preset
from gsrain_engine.session.open_scene import open_scene

from .display import has_display


def view(
    scene: Annotated[str | None, Parameter(help="Scene file or folder; without one, the built-in street.")] = None,
    /,
    *,
    preset: Annotated[
        str | None, Parameter(help="Rain preset (clear, 1.2, 8.5, 12.0, paper) or a preset file.")
    ] = None,
) -> None:
    """Open a scene in the window."""
    if not has_display():
        raise OSError("no display: the window can't open here; gsrain render writes pictures and videos without one")
    from app.window import run_window  # the GUI libraries load only for the window

    run_window(open_scene(scene), load_preset(preset) if preset else None)
