"""Transfers as work for another process: a saved scene and plain values in, pictures and wet colours out."""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8

from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.appearance.methods import method_of, open_transfer
from gsrain_engine.appearance.transfer import Transfer
from gsrain_engine.appearance.transfer_settings import TransferSettings
from gsrain_engine.appearance.views.choice import ViewChoice, chosen_cameras
from gsrain_engine.appearance.views.placed_camera import PlacedCamera
from gsrain_engine.appearance.views.scene_views import scene_views
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.evaluate.report.report_file import write_report
from gsrain_engine.reconstruct.rainy_scene import QUICK, rainy_scene
from gsrain_engine.reconstruct.recoloring.recolored_file import write_recolored
from gsrain_engine.reconstruct.recoloring.settings import RecolorSettings
from gsrain_engine.scene.formats import read_scene
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from ..jobs.torch_extra import HOW_TO_GET_DIFFUSION, require_torch
from .rainy_report import KeptComparisons

_READ, _RENDERED = 0.2, 0.6
"""Shares of a preview's time."""


@dataclass(frozen=True, slots=True)
class TransferOrder:
    """What is to be done to a scene."""

    method: str
    settings: TransferSettings
    choice: ViewChoice
    capture: Path | None = None
    """The scene's recording, where views are its."""
    allow_outside: bool = False
    """Whether files outside of the recording's folder are read that its files name."""


def make_rainy(copy: Path, order: TransferOrder, output: Path, report: Path | None) -> Iterator[Progress]:
    """Work of the job "Make it rainy": transfer views of a saved scene, solve for its wet colours and write them."""
    yield Progress(0.0, "Reading the scene")
    scene = read_scene(copy)
    kept = KeptComparisons(_opened(order.method, order.settings, scene))
    rainy = yield from _with_colors_by(kept, scene, order)
    if report is not None:
        write_report(report, kept.report(rainy, order.method))
    write_recolored(output, {each.key: each.wet_sh for each in rainy.members if each.wet_sh is not None})


def rainy_by(scene: Scene, order: TransferOrder) -> Generator[Progress, None, Scene]:
    """Give a scene the wet colors that an order asks for, in this process; yields and raises as `rainy_scene` does."""
    return (yield from _with_colors_by(_opened(order.method, order.settings, scene), scene, order))


def _with_colors_by(transfer: Transfer, scene: Scene, order: TransferOrder) -> Generator[Progress, None, Scene]:
    capture = None if order.capture is None else open_capture(order.capture, allow_outside=order.allow_outside)
    views = scene_views(scene, chosen_cameras(scene, order.choice, capture))
    # Pictures that don't agree with each other need the robust steps and an exposure each.
    settings = QUICK if order.method == "wet" else RecolorSettings()
    return (yield from rainy_scene(scene, views, transfer, settings))


def preview_view(copy: Path, method: str, settings: TransferSettings, placed: PlacedCamera) -> Iterator[Progress]:
    """Work of a preview: transfer one view of a saved scene; the picture comes with the last step."""
    yield Progress(0.0, "Reading the scene")
    scene = read_scene(copy)
    transfer = _opened(method, settings, scene)
    yield Progress(_READ, "Rendering the view")
    views: Sequence[ClearView] = scene_views(scene, [placed])
    yield Progress(_RENDERED, "Making it rainy", shown(views[0].image))
    for rainy in transfer.transferred(views):
        yield Progress(1.0, "Done", shown(rainy.image))


def shown(image: Float32[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Turn a picture in display colours 0..1 into one that a window shows."""
    return np.rint(np.clip(image, 0, 1) * np.float32(255)).astype(np.uint8)


def _opened(method: str, settings: TransferSettings, scene: Scene) -> Transfer:
    from gsrain_engine.appearance.wet.scene_surroundings import SceneSurroundings

    row = method_of(method)
    if row.needs_torch:
        require_torch(row.title, HOW_TO_GET_DIFFUSION)
    return open_transfer(method, settings, SceneSurroundings(scene))
