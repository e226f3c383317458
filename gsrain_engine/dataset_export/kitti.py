"""KITTI object detection: image_2, velodyne, calib, label_2. Each picture of each camera is a frame of its own.

Facts: the readme of the object development kit (Geiger, Lenz and Urtasun 2012).
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..render.label_export import calibration_file, label_of_box
from ..report.numbers import write_text
from .layout import DatasetLayout, LabeledDataset
from .source import DatasetSource, LidarRows


class KittiLayout(DatasetLayout):
    """`training/image_2/000000.png` and so on, with the numbers of all frames in `ImageSets/train.txt`."""

    name = "kitti"
    summary = "training/image_2/000000.png, velodyne, calib, label_2; a frame for each camera and moment"

    def picture_file(self, source: DatasetSource, moment: int, camera: str) -> str:
        return f"training/image_2/{_frame(source, moment, camera):06d}.png"

    def sweep_files(self, source: DatasetSource, moment: int) -> Sequence[str]:
        return [
            f"training/velodyne/{_frame(source, moment, camera):06d}.bin"
            for camera in source.cameras
            if source.shot(moment, camera) is not None
        ]

    def sweep_bytes(self, rows: LidarRows) -> bytes:
        """Return rows x, y, z (x forward, y left, z up) and reflectance, 0..1, as 32-bit floats."""
        light = np.clip(rows.intensities, 0, 1)
        return np.column_stack([rows.points_m, light]).astype("<f4").tobytes()

    def write_tables(self, dataset: LabeledDataset, folder: Path) -> None:
        source = dataset.source
        lines, numbers = ["frame,moment,time_s,camera"], list[str]()
        for (moment, camera), objects in dataset.objects.items():
            shot = source.shot(moment, camera)
            assert shot is not None
            number = f"{_frame(source, moment, camera):06d}"
            numbers.append(number)
            lines.append(f"{number},{moment},{shot.time_s:.6f},{camera}")
            labels = [
                label_of_box(
                    each["class_name"], _corners(each["bbox"]), each["box_3d"]["size_lwh_m"],
                    np.array(each["box_3d"]["object_to_camera"]), each["visibility"], each["truncation"],
                )
                for each in objects
            ]  # fmt: skip
            write_text(folder / "training" / "label_2" / f"{number}.txt", "".join(f"{each}\n" for each in labels))
            lidar = dataset.lidar_to_world[moment]
            calibration = calibration_file(shot.camera, None if lidar is None else shot.camera.world_to_camera @ lidar)
            write_text(folder / "training" / "calib" / f"{number}.txt", calibration)
        write_text(folder / "ImageSets" / "train.txt", "".join(f"{each}\n" for each in numbers))
        write_text(folder / "frames.csv", "".join(f"{each}\n" for each in lines))


def _frame(source: DatasetSource, moment: int, camera: str) -> int:
    return moment * len(source.cameras) + source.cameras.index(camera)


def _corners(bbox: Sequence[float]) -> tuple[float, float, float, float]:
    left, top, width, height = bbox
    return left, top, left + width, top + height
