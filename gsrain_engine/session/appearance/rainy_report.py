"""The report of "Make it rainy": views as the transfer made them beside what the scene shows of them now."""

import time
from collections.abc import Iterator, Sequence

import numpy as np

from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.appearance.transfer import RainyView, Transfer
from gsrain_engine.evaluate.report.comparison import Comparison
from gsrain_engine.evaluate.report.run_report import RunReport
from gsrain_engine.raster.cpu_renderer import CpuRenderer
from gsrain_engine.scene.scene import Scene

_COMPARED = 6
"""Views that the report shows, at most."""
_SOLID = 0.3
"""Alpha from which a pixel counts."""


class KeptComparisons:
    """A transfer that keeps a few of the views that another one makes, evenly over all."""

    def __init__(self, transfer: Transfer) -> None:
        self._transfer = transfer
        self._kept: list[RainyView] = []
        self._count, self._seconds = 0, 0.0

    @property
    def name(self) -> str:
        return self._transfer.name

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        every = max(1, -(-len(views) // _COMPARED))
        started = time.perf_counter()
        for number, rainy in enumerate(self._transfer.transferred(views)):
            self._seconds += time.perf_counter() - started
            if number % every == 0:
                self._kept.append(rainy)
            self._count += 1
            yield rainy
            started = time.perf_counter()

    def report(self, scene: Scene, method: str) -> RunReport:
        return RunReport(
            f"{scene.name} made rainy",
            {"method": method},
            comparisons=tuple(_compared(scene, each) for each in self._kept),
            timings={"Views and their transfer": self._seconds},
            headlines={"Gaussians": f"{scene.gaussian_count:,}", "Views": f"{self._count:,}"},
        )


def _compared(scene: Scene, rainy: RainyView) -> Comparison:
    parts = [part._replace(colors=None) for part in scene.parts(rainy.clear.time_s, wetness=1.0)]
    renderer = CpuRenderer()
    renderer.draw(parts, rainy.clear.camera)
    rgba = renderer.read().rgba
    alpha = rgba[..., 3]
    drawn = np.clip(rgba[..., :3] + (1 - alpha[..., None]) * rainy.image, 0, 1)
    return Comparison.measured(rainy.clear.name, drawn, rainy.image, alpha > _SOLID)
