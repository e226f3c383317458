"""`gsrain street`: the scene and photographs of it."""

import json

import numpy as np
from PIL import Image

from gsrain_engine.scene.formats.scene_files import read_scene


def test_street_writes_scene_and_photographs(tmp_path, reported):
    numbers = reported("street", tmp_path / "town", "--moments", "1", "--width", "96")
    scene = read_scene(tmp_path / "town" / "scene")
    assert 1_000_000 <= scene.gaussian_count == numbers["gaussians"] <= 1_200_000
    assert set(scene.rigs) == {"waymo_front3", "nuscenes"}
    images = tmp_path / "town" / "images"
    cameras = json.loads((images / "cameras.json").read_text())
    assert len(cameras) == numbers["views"] == 3
    depth = np.load(images / f"{cameras[0]['name']}.depth.npy")
    labels = np.asarray(Image.open(images / f"{cameras[0]['name']}.labels.png"))
    assert depth.shape == labels.shape == (64, 96)
    assert len(np.unique(labels)) >= 4
