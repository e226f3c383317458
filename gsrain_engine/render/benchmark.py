"""How long frames take: what is measured, and what follows from several measurements."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from statistics import median
from typing import NamedTuple

import numpy as np

from .frame import Color
from .renderer import Renderer
from .scene_view import rain_in
from .sequence import FrameSequence
from .statistics import RenderStatistics

_WARM_UP = 2
"""Frames before the first that counts: kernels and shaders compile, buffers take their size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTimes:
    """What the frames of one sequence took. A frame: make its rain, draw, and fetch the picture into memory."""

    scene: str
    backend: str
    width: int
    height: int
    intensity_mm_h: float
    sh_degree: int
    """Highest of all layers and actors."""
    gaussians: int
    """Those of the scene that the last frame was asked to draw; all but rain."""
    splats: int
    """Of scene and rain, drawn in the last frame."""
    drops_drawn: int
    haze_drawn: int
    frames: int
    frame_ms_median: float
    frame_ms_min: float
    frame_ms_max: float
    ns_per_splat: float | None
    """Median frame over splats drawn; none where nothing was drawn."""
    stages_ms: dict[str, float]
    """Medians: rain (making it, on the processor), the renderer's own stages, read."""


def time_frames(renderer: Renderer, sequences: Sequence[FrameSequence], frames: int) -> list[FrameTimes]:
    """Render frames of several sequences and time each.

    Frame by frame they take turns: what else the machine does meanwhile falls on all of them, so that they compare.
    """
    runs = [_Run(renderer, sequence, sequence.sky(renderer).color) for sequence in sequences]
    for number in range(-_WARM_UP, frames):
        for run in runs:
            run.render(max(number, 0), counts=number >= 0)
    return [run.times() for run in runs]


@dataclass(slots=True)
class _Run:
    """One sequence while it is timed."""

    renderer: Renderer
    sequence: FrameSequence
    sky: Color
    frames_ms: list[float] = field(default_factory=list[float])
    stages_ms: dict[str, list[float]] = field(default_factory=dict[str, list[float]])
    last: RenderStatistics = field(default_factory=RenderStatistics)

    def render(self, number: int, *, counts: bool) -> None:
        sequence, shot = self.sequence, self.sequence.shot(number)
        parts = sequence.scene.parts(shot.time_s, wetness=sequence.rainfall.wetness_at(shot.time_s))
        start = time.perf_counter()
        falling = rain_in(sequence.scene, sequence.rainfall, self.sky, shot)
        rained = time.perf_counter()
        self.renderer.draw(parts, shot.camera, falling)
        drawn = time.perf_counter()
        self.renderer.read()
        end = time.perf_counter()
        self.last = self.renderer.statistics
        if counts:
            self.frames_ms.append(1000 * (end - start))
            rain = {"rain": 1000 * (rained - start)} if falling is not None else {}
            for stage, took in (rain | self.last.stages_ms | {"read": 1000 * (end - drawn)}).items():
                self.stages_ms.setdefault(stage, []).append(took)

    def times(self) -> FrameTimes:
        sequence, scene = self.sequence, self.sequence.scene
        frames, splats = len(self.frames_ms), self.last.splats_drawn
        return FrameTimes(
            scene=scene.name,
            backend=self.renderer.name,
            width=sequence.width,
            height=sequence.height,
            intensity_mm_h=sequence.rainfall.state.intensity_mm_h,
            sh_degree=max((each.gaussians.sh_degree for each in scene.members), default=0),
            gaussians=sum(part.drawn_count for part in scene.parts(sequence.time_s(frames - 1))),
            splats=splats,
            drops_drawn=self.last.drops_drawn,
            haze_drawn=self.last.haze_drawn,
            frames=frames,
            frame_ms_median=median(self.frames_ms),
            frame_ms_min=min(self.frames_ms),
            frame_ms_max=max(self.frames_ms),
            ns_per_splat=1e6 * median(self.frames_ms) / splats if splats else None,
            stages_ms={stage: median(took) for stage, took in self.stages_ms.items()},
        )


class Line(NamedTuple):
    """A straight line through the median frames of scenes that differ in their number of Gaussians alone."""

    backend: str
    width: int
    height: int
    sh_degree: int
    scenes: int
    slope_ns_per_gaussian: float
    intercept_ms: float
    r2: float
    """Share of the variance that the line explains, 0 to 1."""


def lines_over_gaussians(rows: Iterable[FrameTimes]) -> list[Line]:
    """Fit a line (least squares) to each back end, size and SH degree of which there are three scenes or more."""
    lines: list[Line] = []
    for key, group in groupby(sorted(rows, key=_kind), _kind):
        alike = list(group)
        if len({row.gaussians for row in alike}) >= 3:
            lines.append(Line(*key, len(alike), *_fitted(alike)))
    return lines


def _kind(row: FrameTimes) -> tuple[str, int, int, int]:
    return row.backend, row.width, row.height, row.sh_degree


def _fitted(rows: Sequence[FrameTimes]) -> tuple[float, float, float]:
    """Slope in ns, intercept in ms, r2."""
    x = np.array([row.gaussians for row in rows], np.float64)
    y = np.array([row.frame_ms_median for row in rows])
    dx, dy = x - x.mean(), y - y.mean()
    slope = float(dx @ dy / (dx @ dx))
    spread = float(dy @ dy)
    r2 = float((dx @ dy) ** 2 / (dx @ dx) / spread) if spread > 0 else 1.0
    return 1e6 * slope, float(y.mean() - slope * x.mean()), min(r2, 1.0)


class RainCost(NamedTuple):
    """What rain adds to a frame, as a share of the same frame without it."""

    scene: str
    backend: str
    width: int
    height: int
    intensity_mm_h: float
    share: float


def rain_costs(rows: Sequence[FrameTimes]) -> list[RainCost]:
    """Compare each rainy row with the clear one of the same scene, back end and size, where there is one."""
    clear = {_same(row): row.frame_ms_median for row in rows if row.intensity_mm_h == 0}
    return [
        RainCost(*_same(row), row.intensity_mm_h, row.frame_ms_median / clear[_same(row)] - 1)
        for row in rows
        if row.intensity_mm_h > 0 and _same(row) in clear
    ]


def _same(row: FrameTimes) -> tuple[str, str, int, int]:
    return row.scene, row.backend, row.width, row.height
