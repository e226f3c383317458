"""Wet colors for a scene from transferred views."""

from collections.abc import Generator, Sequence

from ..appearance.base import ClearView, Transfer
from ..scene.progress import Progress, subprogress
from ..scene.scene import Scene
from .problem import RecolorSettings
from .recolor import recolor_scene
from .result import with_colors
from .views import TargetView, thumbnail

QUICK = RecolorSettings(iterations=10, rounds=1, sh_degree=1, tikhonov=0.3, exposure=False, robust=False)
"""For transfers with consistent views; degree 1 suffices for a wet road."""

_VIEWS_DONE = 0.7  # share of the total time, measured on the built-in street with the wet look


def rainy_scene(
    scene: Scene, views: Sequence[ClearView], transfer: Transfer, settings: RecolorSettings = QUICK
) -> Generator[Progress, None, Scene]:
    """Give a scene wet colors; its geometry and clear colors are unchanged.

    It may be stopped at every step without having written anything. Previews are thumbnails of the latest transferred
    view, then of the first view with the current colors.

    Args:
        scene: Scene to recolor.
        views: Its views; may be lazy.
        transfer: Transfer that makes a view rainy; fully wet, since wetness then blends between clear and wet colors.
        settings: Settings of the color solver.

    Yields:
        Progress.

    Returns:
        The scene with wet colors.

    Raises:
        ValueError: Without views, or if none shows anything of the scene.
    """
    if not len(views):
        raise ValueError("a scene needs at least one view to become rainy")
    targets = yield from _transferred(views, transfer)
    recolored = yield from subprogress(recolor_scene(scene, targets, [], settings), _VIEWS_DONE, 1.0)
    return with_colors(scene, recolored.colors)


def _transferred(views: Sequence[ClearView], transfer: Transfer) -> Generator[Progress, None, list[TargetView]]:
    targets, preview = list[TargetView](), None
    rainy = iter(transfer.transferred(views))
    while True:
        done, count = len(targets), len(views)
        yield Progress(_VIEWS_DONE * done / count, f"Making view {min(done + 1, count)} of {count} rainy", preview)
        made = next(rainy, None)
        if made is None:
            return targets
        targets.append(TargetView(made.clear.name, made.clear.camera, made.clear.time_s, made.image))
        preview = thumbnail(made.image)
