"""COCO: images, one file of annotations with boxes, masks and categories.

Facts: cocodataset.org/#format-data (Lin et al. 2014).
"""

import json
from pathlib import Path

from ..render.label_export import CocoLabels
from ..report.numbers import write_text
from .layout import DatasetLayout, LabeledDataset, camera_word
from .source import DatasetSource


class CocoLayout(DatasetLayout):
    """`images/CAMERA/000000.jpg` and `annotations.json`."""

    name = "coco"
    summary = "images/CAMERA/000000.jpg, annotations.json with boxes, masks and 3D boxes"
    has_lidar = False

    def picture_file(self, source: DatasetSource, moment: int, camera: str) -> str:
        return f"images/{camera_word(camera)}/{moment:06d}.jpg"

    def write_tables(self, dataset: LabeledDataset, folder: Path) -> None:
        source = dataset.source
        coco = CocoLabels(source.name)
        for (moment, camera), objects in dataset.objects.items():
            shot = source.shot(moment, camera)
            assert shot is not None
            name = self.picture_file(source, moment, camera)
            coco.add_annotations(moment, shot.time_s, shot.camera, objects, file_name=name, sensor=camera)
        write_text(folder / "annotations.json", json.dumps(coco.document) + "\n")
