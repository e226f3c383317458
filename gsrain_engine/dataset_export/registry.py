"""Layouts of data sets by name."""

from collections.abc import Mapping

from .coco import CocoLayout
from .kitti import KittiLayout
from .layout import DatasetLayout
from .nuscenes import NuscenesLayout

LAYOUTS: Mapping[str, DatasetLayout] = {each.name: each for each in (NuscenesLayout(), KittiLayout(), CocoLayout())}
