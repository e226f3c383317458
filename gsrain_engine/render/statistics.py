"""What the last frame was made of, and how long each stage of it took."""

import time
from dataclasses import dataclass, field


@dataclass(slots=True)
class RenderStatistics:
    """What the last frame was made of."""

    gaussians: int = 0
    splats_drawn: int = 0
    drops_drawn: int = 0
    """Drops that became streaks; each is one to four Gaussians."""
    haze_drawn: int = 0
    """Haze Gaussians that were handed to the renderer."""
    stages_ms: dict[str, float] = field(default_factory=dict[str, float])
    """Wall time a stage: project, sort, draw (GPU work included, since each stage waits for its result)."""


class Stopwatch:
    """Adds the wall time of a `with` block to a stage, in milliseconds."""

    def __init__(self, stages: dict[str, float], stage: str) -> None:
        self._stages, self._stage = stages, stage

    def __enter__(self) -> None:
        self._start = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._stages[self._stage] += 1000 * (time.perf_counter() - self._start)
