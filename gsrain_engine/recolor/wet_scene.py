"""Quick wet look for a scene from a few small views, without network weights."""

from collections.abc import Generator

from ..appearance.scene_views import ViewChoice, chosen_cameras, scene_views
from ..appearance.wet_look.environment import SceneEnvironment
from ..appearance.wet_look.settings import WetSettings
from ..appearance.wet_look.translator import WetTransfer
from ..scene.progress import Progress
from ..scene.scene import Scene
from .rainy_scene import rainy_scene

VIEWS = 8


def wet_scene(scene: Scene, settings: WetSettings | None = None) -> Generator[Progress, None, Scene]:
    """Give a scene wet colors from `VIEWS` views of 480 x 320 pixels. Yields and raises as `rainy_scene` does."""
    views = scene_views(scene, chosen_cameras(scene, ViewChoice(count=VIEWS)))
    transfer = WetTransfer(settings or WetSettings(), SceneEnvironment(scene))
    return rainy_scene(scene, views, transfer)
