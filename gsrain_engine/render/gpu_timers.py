"""How long each stage of a frame takes on the GPU, without making anyone wait for it."""

import time
from collections.abc import Generator
from contextlib import contextmanager

import moderngl

from .context import is_software


class GpuTimers:
    """One timer query a stage; `collect` reads them when the frame is long done.

    A software rasterizer's queries mean nothing: there each stage is waited for and its wall time taken, which costs
    little where the same processor does the work.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._is_software = is_software(context)
        self._free: list[moderngl.Query] = []
        self._running: list[tuple[str, moderngl.Query]] = []
        self._stages_ms: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Generator[None]:
        """Measure the work that is handed to OpenGL within the block. Stages don't nest; of one name they add up."""
        if self._is_software:
            start = time.perf_counter()
            yield
            self._context.finish()
            self._add(name, 1000 * (time.perf_counter() - start))
            return
        query = self._free.pop() if self._free else self._context.query(time=True)
        with query:
            yield
        self._running.append((name, query))

    def collect(self) -> dict[str, float]:
        """Milliseconds by stage since the last call; waits for the GPU where it is not done yet."""
        for name, query in self._running:
            self._add(name, query.elapsed / 1e6)
            self._free.append(query)
        self._running.clear()
        collected, self._stages_ms = self._stages_ms, {}
        return collected

    def _add(self, name: str, milliseconds: float) -> None:
        self._stages_ms[name] = self._stages_ms.get(name, 0.0) + milliseconds
