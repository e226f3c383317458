"""What a worker keeps from job to job: the scene that it has opened, and the renderer."""

import threading
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

from gsrain_engine.backends import Backend, open_renderer
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.scene.content_hash import file_hash, scene_hash
from gsrain_engine.scene.open_scene import open_to_draw
from gsrain_engine.scene.scene import Scene


class MismatchError(ValueError):
    """What a worker has is not what the sweep was made of: that says nothing about the job."""


_SCENES = 2
"""So many stay open; jobs come sorted by scene."""


class Workbench:
    """Scenes and renderers, opened when they are first asked for."""

    def __init__(self) -> None:
        self._scenes: OrderedDict[tuple[str, str], Scene] = OrderedDict()
        self._renderers: dict[Backend, Renderer] = {}
        self._stack = ExitStack()

    def scene(self, name: str, content: str) -> Scene:
        """Return a scene, which holds what its hash says.

        Raises MismatchError where it holds something else by now.
        """
        key = name, content
        if key not in self._scenes:
            found = scene_hash(name)
            if found != content:
                raise MismatchError(f"scene {name} is not what it was when the sweep began ({found}, not {content})")
            while len(self._scenes) >= _SCENES:
                self._scenes.popitem(last=False)
            self._scenes[key] = open_to_draw(name)
        self._scenes.move_to_end(key)
        return self._scenes[key]

    def check_files(self, hashes: Mapping[str, str]) -> None:
        """Raise MismatchError for a file that is not here, or holds something else than its hash says."""
        for name, content in hashes.items():
            path = Path(name)
            found = file_hash(path) if path.is_file() else "not there"
            if found != content:
                raise MismatchError(f"{name} is not what it was when the sweep began ({found}, not {content})")

    def renderer(self, backend: Backend) -> Renderer:
        """Return a renderer, which stays open until `close`."""
        if backend not in self._renderers:
            self._renderers[backend] = self._stack.enter_context(open_renderer(backend))
        return self._renderers[backend]

    def close(self) -> None:
        """Let go of everything; it may be used again."""
        self._scenes.clear()
        self._renderers.clear()
        self._stack.close()


_HERE = threading.local()


def workbench() -> Workbench:
    """Return that of this thread: what draws belongs to the thread that opened it."""
    if not hasattr(_HERE, "bench"):
        _HERE.bench = Workbench()
    return _HERE.bench
