"""Which kinds of label files there are."""

from typing import Literal

LabelFormat = Literal["coco", "kitti"]
