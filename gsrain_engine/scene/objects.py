"""Objects with a class and a box in a scene, and object classes of COCO and of data sets."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from .built_in import SceneBox, built_in_scene
from .gaussians import Gaussians
from .scene import Actor, Layer, PoseTrack, Scene

_MARGIN_M = 0.2  # includes mirrors and Gaussians that protrude from a box
_SHADOW_HEIGHT_M, _SHADOW_OPACITY = 0.1, 0.9  # lower and less opaque Gaussians are the object's baked shadow
_MIN_SHARE = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class SceneObject:
    """An object in a scene, with the Gaussians that show it."""

    id: str
    class_name: str
    size_lwh: tuple[float, float, float]
    """Length, width, height in the scene's units."""
    track: PoseTrack
    """From the object's frame (x forward, y left, z up, origin at the bottom center) to the scene."""
    member: str
    """Key of the layer or actor with its Gaussians."""
    rows: Int64[np.ndarray, " n"]
    """Indices of the member's Gaussians, increasing."""


def scene_objects(scene: Scene) -> tuple[SceneObject, ...]:
    """Objects with a class and a box, of visible members.

    Actors first, then vehicles, people and traffic lights of a built-in scene.
    """
    objects = [_of_actor(actor) for actor in scene.actors if actor.visible]
    built_in = built_in_scene(scene.name)
    boxes = [] if built_in is None else built_in.boxes()
    for layer in scene.layers:
        own = [box for box in boxes if box.layer == layer.name]
        if own and layer.visible:
            objects += _of_layer(layer, own)
    return tuple(objects)


def _of_actor(actor: Actor) -> SceneObject:
    own = _inside(actor.gaussians.means.astype(np.float64), actor.size_lwh) & ~_is_shadow(actor.gaussians)
    rows = np.flatnonzero(own) if own.any() else np.arange(len(actor.gaussians))
    return SceneObject(actor.id, actor.class_name, actor.size_lwh, actor.track, actor.key, _drawn_rows(actor, rows))


def _of_layer(layer: Layer, boxes: Iterable[SceneBox]) -> list[SceneObject]:
    """Assign a layer's Gaussians to boxes; empty if most are in none, as the layer is then another scene's."""
    means = layer.gaussians.means.astype(np.float64)
    objects: list[SceneObject] = []
    for box in boxes:
        rotation, origin = box.to_layer[:3, :3], box.to_layer[:3, 3]
        near = np.flatnonzero(np.abs(means[:, :2] - origin[:2]).max(axis=1) < max(box.size_lwh))
        rows = near[_inside((means[near] - origin) @ rotation, box.size_lwh)]
        track = PoseTrack.standing(layer.to_scene @ box.to_layer)
        scale = float(np.cbrt(np.linalg.det(layer.to_scene[:3, :3])))
        length, width, height = (scale * side for side in box.size_lwh)
        objects.append(
            SceneObject(box.id, box.class_name, (length, width, height), track, layer.key, _drawn_rows(layer, rows))
        )
    found = len(means) > 0 and sum(len(each.rows) for each in objects) >= _MIN_SHARE * _present(layer)
    return [each for each in objects if len(each.rows)] if found else []


def _inside(points: Float64[np.ndarray, "n 3"], size_lwh: tuple[float, float, float]) -> Bool[np.ndarray, " n"]:
    """Points in an object's frame that are inside its box, or nearly so."""
    reach = np.array(size_lwh) / 2 + _MARGIN_M
    return np.asarray((np.abs(points - [0, 0, size_lwh[2] / 2]) <= reach).all(axis=1))


def _is_shadow(gaussians: Gaussians) -> Bool[np.ndarray, " n"]:
    return (gaussians.means[:, 2] < _SHADOW_HEIGHT_M) & (gaussians.opacities < _SHADOW_OPACITY)


def _drawn_rows(member: Layer | Actor, rows: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " m"]:
    """Rows that are drawn: neither hidden nor deleted."""
    left_out = member.marks.left_out
    return rows if left_out is None else rows[~left_out.flags[rows]]


def _present(layer: Layer) -> int:
    left_out = layer.marks.left_out
    return len(layer.gaussians) - (0 if left_out is None else left_out.size)


# Object classes

COCO_CLASSES: tuple[str, ...] = (
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat", "traffic light",
    "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog", "horse", "sheep", "cow", "elephant",
    "bear", "zebra", "giraffe", "backpack", "umbrella", "handbag", "tie", "suitcase", "frisbee", "skis", "snowboard",
    "sports ball", "kite", "baseball bat", "baseball glove", "skateboard", "surfboard", "tennis racket", "bottle",
    "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich", "orange", "broccoli",
    "carrot", "hot dog", "pizza", "donut", "cake", "chair", "couch", "potted plant", "bed", "dining table", "toilet",
    "tv", "laptop", "mouse", "remote", "keyboard", "cell phone", "microwave", "oven", "toaster", "sink",
    "refrigerator", "book", "clock", "vase", "scissors", "teddy bear", "hair drier", "toothbrush",
)  # fmt: skip
"""The 80 classes of COCO 2017 in the order of detectors (Lin et al. 2014)."""

_UNUSED = {12, 26, 29, 30, 45, 66, 68, 69, 71, 83}
COCO_CATEGORIES = dict(zip(COCO_CLASSES, [k for k in range(1, 91) if k not in _UNUSED], strict=True))
"""Category ids of COCO's annotation files by class: 1 to 90, ten of them unused."""

_SAME = {
    "person": r"pedestrian|person|human(\..*)?|people|walker|adult|child",
    "bicycle": r"bicycle|bike|cycle",
    "motorcycle": r"motorcycle|motorbike|motor|moped|scooter",
    "car": r"car|van|suv|sedan|taxi|passenger car|vehicle",
    "bus": r"bus|coach|bus\..*",
    "truck": r"truck|lorry|caravan/rv|pickup truck|semi-truck",
    "train": r"train|tram|subway|streetcar",
    "traffic light": r"traffic light|traffic signal",
    "stop sign": r"stop sign",
}
"""Patterns for names in KITTI, nuScenes, Waymo, DGP, BDD100K and RainSense, in lower case, by class of COCO."""

_GROUP = re.compile(r"^((vehicle|movable_object|static_object)\.|type_)")


def coco_class(name: str) -> str:
    """Class of COCO for a data set's class name; the name itself, in lower case, if there is none.

    Riders (KITTI's Cyclist, BDD100K's rider) stay as they are: COCO labels the person and the bicycle separately.
    Waymo's vehicle becomes a car, as most of them are.
    """
    plain = _GROUP.sub("", name.strip().lower()).replace("_", " ")
    for known, pattern in _SAME.items():
        if re.fullmatch(pattern, plain):
            return known
    return plain


# Vehicle classes

_VEHICLES = ("car", "truck", "van", "bus", "vehicle", "trailer", "tram", "train")
_CYCLES = ("cycl", "bike", "motor")


def is_vehicle(class_name: str) -> bool:
    """Return whether a class is a motor vehicle with a body: car, truck or tram, but no bicycle or rider."""
    name = class_name.lower()
    return any(word in name for word in _VEHICLES) and not any(word in name for word in _CYCLES)
