"""A transfer of views from their source to a folder of rainy ones."""

import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Bool, Float64

from ..datasets.capture import Capture
from ..report.result import RunResult
from ..report.table import Cell, Table, columns
from ..scene.progress import Progress
from ..scene.scene import Scene
from .base import ClearView, NetworkTransfer, SkippedCounts, TransferSettings
from .capture_views import CaptureViews
from .output_folder import ContactSheet, TransferRecord, write_transferred
from .registry import open_transfer
from .scene_views import OWN_WIDTH_PX, chosen_cameras, chosen_views, scene_views
from .view_choice import ViewChoice
from .wet_look.environment import ImageEnvironment, ReflectionEnvironment, SceneEnvironment


@dataclass(frozen=True, slots=True, eq=False)
class SourceViews:
    """Views in the world, computed on demand, and their surroundings."""

    name: str
    views: Sequence[ClearView]
    surroundings: ReflectionEnvironment
    to_world: Float64[np.ndarray, "4 4"]
    """Similarity from the units and axes of the scene or capture to the world."""
    width_px: int
    """Width of the widest image."""
    mask: Callable[[str], Bool[np.ndarray, "h w"] | None]
    """Mask of pixels to learn from, by view name; None means all."""


def source_views(source: Scene | Capture, choice: ViewChoice, capture: Capture | None = None) -> SourceViews:
    """Place the chosen views in a scene, or among the images of a capture; `capture` has a scene's recorded cameras.

    Raises ValueError, which begins with the setting, if the choice doesn't fit.
    """
    if isinstance(source, Scene):
        if choice.source == "recorded" and capture is None:
            raise ValueError("source recorded: needs --capture, where the cameras come from")
        placed = chosen_cameras(source, choice, capture, OWN_WIDTH_PX)
        views, around = scene_views(source, placed), SceneEnvironment(source)
        width_px = max(each.camera.width for each in placed)
        return SourceViews(source.name, views, around, source.scene_to_world, width_px, lambda name: None)
    if choice.source not in ("auto", "recorded"):
        raise ValueError(f"source {choice.source}: {source.name} is a capture, whose views are those of its pictures")
    if capture is not None:
        raise ValueError(f"capture: {source.name} is a capture itself")
    max_px = choice.width_px or OWN_WIDTH_PX
    opened = chosen_views(source, choice)
    views, width_px = CaptureViews(opened, max_px), max(min(max_px, view.camera.width) for view in opened)
    return SourceViews(opened.name, views, ImageEnvironment(), views.to_world, width_px, views.mask)


def transfer_views(
    opened: SourceViews, method: str, settings: TransferSettings, choice: ViewChoice, output: Path
) -> Generator[Progress, None, RunResult[Path]]:
    """Make views rainy, and write them into a folder that is a capture; OUTPUT/clear holds the original views.

    The figure of the result shows some views before and after. Raises ValueError for a method that is unknown or lacks
    what it needs, `CaptureError` for an image that can't be read, `OSError` when the folder can't be written.
    """
    model = open_transfer(method, settings, opened.surroundings)
    values = msgspec.to_builtins(settings, enc_hook=str) | msgspec.to_builtins(choice) | {"width_px": opened.width_px}
    network = model.network_input(opened.views[0]) if isinstance(model, NetworkTransfer) else None
    framing: dict[str, Any] = {} if network is None else msgspec.to_builtins(network)
    record = TransferRecord(method, opened.name, values | framing, opened.to_world)
    count, started, sheet = len(opened.views), time.perf_counter(), ContactSheet(len(opened.views))
    left_out, rows = SkippedCounts(), list[tuple[Cell, ...]]()
    for view in write_transferred(output, model.transferred(opened.views), record, opened.mask):
        left_out.add(view)
        sheet.add(view)
        rows.append((view.clear.name, None if view.film is None else float(view.film.mean())))
        yield Progress(len(rows) / count, f"Rainy view {len(rows)} of {count}")
    seconds = time.perf_counter() - started
    films = [each for _, each in rows if isinstance(each, float)]
    numbers = {
        "method": method, "width_px": opened.width_px, **framing, "views": len(rows), "seconds": round(seconds, 3),
        "seconds_per_view": round(seconds / max(len(rows), 1), 3),
        "film_share_mean": round(float(np.mean(films)), 5) if films else None, "notes": list(left_out.sentences),
    }  # fmt: skip
    made = f"{output}: {len(rows)} rainy views of {opened.name}, {opened.width_px} px wide, in {seconds:.1f} s"
    lines = (*left_out.sentences, *([] if network is None else [network.words]), made)
    table = Table(f"Rainy views of {opened.name}", columns({"view": "", "share of water": ".3f"}), rows)
    return RunResult(made=output, table=table, numbers=numbers, lines=lines, draw=lambda: np.asarray(sheet.picture()))
