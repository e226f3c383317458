"""Time to save and to autosave an edited scene, and the window's delay by it. Prints JSON.

A editor does what a person does: saves a scene of random Gaussians, deletes some by marks, gives all another color.
After each change the document is saved, and kept as an autosave. The main thread meanwhile does what it does each
frame, `update`, and nothing else: the longest time between two calls is what a window would stall for beyond drawing.
"""

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.render.renderer import describe_machine
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.open import random_scene

_PAUSE_S = 0.001
"""Between two calls of `update`, for which a window would draw."""


def waited(editor: Editor, begin: Callable[[], None]) -> dict[str, float]:
    """Seconds until everything in the background is through, and the longest time between two updates."""
    start = last = time.perf_counter()
    begin()
    longest = time.perf_counter() - last
    while True:
        editor.tick(0.0)
        now = time.perf_counter()
        longest, last = max(longest, now - last), now
        if not editor.background.tasks:
            return {"seconds": round(now - start, 3), "longest_update_ms": round(1000 * longest, 1)}
        time.sleep(_PAUSE_S)


def autosaved(editor: Editor) -> dict[str, float]:
    """Duration of a due autosave."""
    editor.tick(0.0)
    late = time.monotonic() + editor.preferences.value.autosave_s
    editor.files.recovery.now = lambda: late
    taken = waited(editor, lambda: editor.tick(0.0))
    editor.files.recovery.now = time.monotonic
    return taken


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="random-1m", help="random scene, as of `gsrain bench render`")
    parser.add_argument("--folder", type=Path, help="where to write; by default a temporary folder")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        os.environ["XDG_STATE_HOME"] = os.environ["XDG_CONFIG_HOME"] = folder  # not among a person's own recent files
        home = Path(folder) / "scene"
        editor = Editor(random_scene(arguments.scene))
        gaussians = editor.document.scene.members[0].gaussians
        results = {"save for the first time": waited(editor, lambda: editor.files.save_to(home))}
        chosen = np.random.default_rng(0).random(len(gaussians)) < 0.3
        changes = {
            "marks": {"marks": SelectionFlags(deleted=BitMask.of(chosen))},
            "colors": {"gaussians": gaussians.with_sh((gaussians.sh * np.float32(0.8)).astype(np.float32))},
        }
        for name, fields in changes.items():
            editor.document.edit(
                name, replace_scene, editor.document.scene.with_member(editor.document.scene.members[0].key, **fields)
            )
            results[f"autosave after a change of {name}"] = autosaved(editor)
            results[f"save after a change of {name}"] = waited(editor, editor.files.save)
        editor.close()
    print(json.dumps({"scene": arguments.scene, "results": results, "machine": describe_machine()}, indent=1))


if __name__ == "__main__":
    main()
