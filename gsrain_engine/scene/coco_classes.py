"""COCO's classes of objects, with its numbers, and what data sets call the same things."""

import re

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
"""Names of KITTI, nuScenes, Waymo, DGP, BDD100K and RainSense, in lower case, by the class of COCO they fall into."""

_GROUP = re.compile(r"^((vehicle|movable_object|static_object)\.|type_)")


def coco_class(name: str) -> str:
    """The class of COCO that a data set's `name` falls into; the name itself, in lower case, where none is the same.

    Riders (KITTI's Cyclist, BDD100K's rider) stay as they are: COCO labels the person and the bicycle each alone.
    Waymo's vehicle becomes a car, which most of them are.
    """
    plain = _GROUP.sub("", name.strip().lower()).replace("_", " ")
    for known, pattern in _SAME.items():
        if re.fullmatch(pattern, plain):
            return known
    return plain
