"""A scene becomes rainy: its views are transferred, and its colours are solved for so that it looks like them."""

from collections.abc import Generator, Sequence

from ..appearance.base import ClearView, Transfer
from ..scene.progress import Progress, subprogress
from ..scene.scene import Scene
from .problem import RecolorSettings
from .recolor import recolor_scene
from .result import with_colors
from .views import TargetView, thumbnail

QUICK = RecolorSettings(iterations=10, rounds=1, sh_degree=1, tikhonov=0.3, exposure=False, robust=False)
"""For transfers whose views agree with each other; degree 1 is all that a wet road needs."""

_VIEWS_DONE = 0.7
"""Share of the whole time, measured on the built-in street with the wet look."""


def rainy_scene(
    scene: Scene, views: Sequence[ClearView], transfer: Transfer, settings: RecolorSettings = QUICK
) -> Generator[Progress, None, Scene]:
    """Give a scene wet colours; its geometry and its clear colours stay as they are.

    It can be stopped at every step, and has written nothing then. The previews are small pictures of the view that was
    made rainy last, and then of how the first of them looks with the colours so far.

    Args:
        scene: What is to become rainy.
        views: Views of it, which may be worked out when they are asked for.
        transfer: What makes a view rainy; soaked, since wetness then blends between clear and wet colours.
        settings: How colours are solved for.

    Yields:
        How far it has come.

    Returns:
        The scene with wet colours.

    Raises:
        ValueError: When there is no view, or none shows anything of the scene.
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
