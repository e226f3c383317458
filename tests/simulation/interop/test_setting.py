"""The rig that HUGSIM's clients are given."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.scene.street.build import street_rigs
from gsrain_engine.simulation.interop.hugsim_protocol import (
    CAMERA_NAMES,
    hugsim_rig,
    six_hugsim_cameras,
    with_hugsim_rig,
)
from gsrain_engine.simulation.vehicle import HUGSIM_VEHICLE
from simulation.interop.road_with_lead import scenario, scene


def named(rig, name):
    return next(each for each in rig if each.name == name)


def test_nuscenes_rig_is_halved_and_moved_back():
    rig, was = hugsim_rig(street_rigs()["nuscenes"]), street_rigs()["nuscenes"]
    assert tuple(each.name for each in rig) == CAMERA_NAMES
    assert {(each.width, each.height) for each in rig} == {(800, 450)}
    front, before = named(rig, "CAM_FRONT"), named(was, "CAM_FRONT")
    assert (front.fx, front.cx, front.cy) == (before.fx / 2, before.cx / 2, before.cy / 2)
    np.testing.assert_allclose(front.camera_to_ego[:2, 3], 0)
    assert front.camera_to_ego[2, 3] == before.camera_to_ego[2, 3]
    for name in CAMERA_NAMES:  # all alike
        np.testing.assert_allclose(
            named(rig, name).camera_to_ego[:3, 3] - named(was, name).camera_to_ego[:3, 3], (-1.7, -0.02, 0)
        )


def test_waymo_cameras_are_renamed_and_cut_to_the_format():
    rig = hugsim_rig(street_rigs()["waymo_front3"])
    assert [each.name for each in rig] == ["CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT"]
    front = rig[0]
    scale = 800 / 1920
    assert (front.width, front.height, front.fx) == (800, 450, 2059 * scale)
    assert front.cy == pytest.approx(225.0)  # the middle row stays in the middle: 533 rows, 42 off each end


def test_missing_cameras_are_known_all_the_same():
    two = tuple(each for each in hugsim_rig(street_rigs()["nuscenes"]) if each.name in ("CAM_FRONT", "CAM_BACK"))
    six, full = six_hugsim_cameras(two), hugsim_rig(street_rigs()["nuscenes"])
    assert tuple(six) == CAMERA_NAMES
    for name in CAMERA_NAMES:
        np.testing.assert_allclose(six[name].camera_to_ego, named(full, name).camera_to_ego, atol=1e-12)


def test_no_front_camera():
    sides = tuple(each for each in street_rigs()["nuscenes"] if "BACK" in each.name)
    with pytest.raises(ValueError, match="needs a camera CAM_FRONT"):
        hugsim_rig(sides)
    with pytest.raises(ValueError, match="not only no cameras"):
        with_hugsim_rig(scenario(), replace(scene(), rigs={}))


def test_a_camera_of_another_size_is_refused():
    with pytest.raises(ValueError, match=r"CAM_FRONT is 1600 x 900: HUGSIM's clients take 800 x 450"):
        six_hugsim_cameras(street_rigs()["nuscenes"])


def test_setting_takes_the_rig_with_most_of_the_six():
    rigs = {"waymo_front3": street_rigs()["waymo_front3"], "nuscenes": street_rigs()["nuscenes"]}
    changed, with_rig = with_hugsim_rig(scenario(), replace(scene(), rigs=rigs))
    assert (changed.vehicle, changed.rig, changed.picture_width_px) == (HUGSIM_VEHICLE, "hugsim", 800)
    assert len(with_rig.rigs["hugsim"]) == 6
    assert set(with_rig.rigs) == {"waymo_front3", "nuscenes", "hugsim"}


def test_setting_keeps_to_the_rig_that_a_scenario_names():
    rigs = {"waymo_front3": street_rigs()["waymo_front3"], "nuscenes": street_rigs()["nuscenes"]}
    _, with_rig = with_hugsim_rig(scenario(rig="waymo_front3"), replace(scene(), rigs=rigs))
    assert len(with_rig.rigs["hugsim"]) == 3
    with pytest.raises(ValueError, match="has no rig 'other', only nuscenes"):
        with_hugsim_rig(scenario(rig="other"), scene())
