"""Settings of a drive before it starts."""

from dataclasses import replace

import msgspec
import numpy as np

from gsrain_engine.editor.drive import CameraMosaic, DriveSetup, mosaic_rows

from .driven import driven


def test_what_is_out_of_bounds_is_not_taken():
    wanted = DriveSetup()
    before = wanted.scenario
    wanted.change(msgspec.structs.replace(before, speed_m_s=-1.0))
    assert wanted.scenario is before
    assert "speed_m_s" in wanted.error
    wanted.load("no-such-scenario")
    assert "no-such-scenario" in wanted.error
    assert wanted.scenario is before


def test_the_mosaic_shows_the_rig_as_one_would_look_for_it():
    scene = driven()[0]
    (front,) = scene.rigs["one"]
    turned = {}
    for name, degrees in (("left", 55), ("right", -55), ("back", 180), ("back left", 110), ("back right", -110)):
        pose = front.camera_to_ego.copy()
        pose[:3, :3] = rotation(degrees) @ pose[:3, :3]
        turned[name] = replace(front, name=name, camera_to_ego=pose)
    rows = mosaic_rows([front, *(turned[name] for name in ("back right", "right", "back", "left", "back left"))])
    names = [[each.name for each in row] for row in rows]
    assert names == [["left", "FRONT", "right"], ["back left", "back", "back right"]]
    mosaic = CameraMosaic(rig="gone")
    assert mosaic.cameras(scene) == (front,)
    mosaic.want(251.0)
    assert (mosaic.is_requested, mosaic.width_px) == (True, 256)


def rotation(degrees):
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])
