"""A scene gets the wet look in a few seconds: few small views of it, without any weights."""

from collections.abc import Generator

from gsrain_engine.appearance.views.choice import ViewChoice, chosen_cameras
from gsrain_engine.appearance.views.scene_views import scene_views
from gsrain_engine.appearance.wet.scene_surroundings import SceneSurroundings
from gsrain_engine.appearance.wet.settings import WetSettings
from gsrain_engine.appearance.wet.transfer import WetTransfer
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from .rainy_scene import rainy_scene

VIEWS = 8


def wet_scene(scene: Scene, settings: WetSettings | None = None) -> Generator[Progress, None, Scene]:
    """Give a scene the wet colours of a quick look: from `VIEWS` views of 480 x 320 pixels.

    Yields and raises as `rainy_scene` does.
    """
    views = scene_views(scene, chosen_cameras(scene, ViewChoice(count=VIEWS)))
    transfer = WetTransfer(settings or WetSettings(), SceneSurroundings(scene))
    return rainy_scene(scene, views, transfer)
