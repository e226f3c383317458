"""Labelled objects of a rendered view: what a scene's actors and parked vehicles show of themselves in it."""

from collections.abc import Sequence

from gsrain_engine.render.objects.seen_objects import seen_objects
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.objects import SceneObject
from gsrain_engine.scene.scene import Scene

from .class_names import label_class
from .truth import LabelledObject


def truth_from_scene(
    renderer: Renderer, scene: Scene, objects: Sequence[SceneObject], camera: Camera, time_s: float
) -> tuple[LabelledObject, ...]:
    """Render which pixels show which object, from a camera in the world (metres); the nearest object first.

    Boxes are those of visible pixels, as people draw them around what they see. Rain takes no part.
    """
    return tuple(
        LabelledObject(
            each.object.id, label_class(each.object.class_name), each.box_xyxy, each.visibility, each.distance_m
        )
        for each in seen_objects(renderer, scene, objects, camera, time_s)
    )
