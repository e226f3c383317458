"""`gsrain edit`: applies the edits of the window to a scene, such as the steps that its History panel copies."""

import sys
from pathlib import Path
from typing import Annotated

from .console import counted, print, print_lines
from .options import Orientation, flag, option
from .outputs import SCREEN, check_scene_target, lock_outputs


def edit(
    scene: Annotated[str | None, option('Scene file or folder; "street" is the built-in scene.')] = None,
    /,
    *steps: Annotated[str, option('Edits in order, such as "rename key=layers/road name=asphalt".')],
    output: Annotated[
        Path | None, option("Scene folder, or file (.ply .spz .glb .usdz ...), to write.", "--output", "-o")
    ] = None,
    steps_file: Annotated[
        Path | None,
        option("Text file with an edit a line, before STEPS; - is the input.", "--steps", allow_leading_hyphen=True),
    ] = None,
    orientation: Orientation | None = None,
    list_: Annotated[bool, flag("List all edits with their parameters.")] = False,
) -> None:
    """Edit a scene by steps: each is the name of an edit, and its parameters with JSON values.

    History in the window copies its steps in this form.
    """
    from gsrain_engine.editor.steps import EditStep, apply_steps, edit_help
    from gsrain_engine.scene.formats.scene_files import write_scene
    from gsrain_engine.scene.open import load_sorted_scene

    if list_:
        for each in edit_help():
            print_lines(f"{each.name} {each.parameters}".rstrip() + f"\n    {each.summary}")
        return
    if scene is None or output is None:
        raise ValueError("expected a scene and --output; --list lists the edits")
    check_scene_target(output)
    lines = [] if steps_file is None else _read(steps_file).splitlines()
    texts = [line for line in lines if line.strip() and not line.lstrip().startswith("#")] + list(steps)
    parsed = [EditStep.parse(text) for text in texts]
    opened = (orientation or Orientation()).of(load_sorted_scene(scene))
    lock_outputs(output)
    edited = apply_steps(opened, parsed)
    write_scene(edited, output, in_drawing_order=True)
    print(f"{output}: {counted(edited.gaussian_count, 'Gaussian')} after {counted(len(parsed), 'edit')}")


def _read(file: Path) -> str:
    from gsrain_engine.safe_io.text_files import read_whole

    return sys.stdin.read() if file == SCREEN else read_whole(file).decode()
