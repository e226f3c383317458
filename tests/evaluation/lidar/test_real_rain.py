"""RainSense's own lidar at 9.2 mm/h: no drop answers in it, and none may in what is made of its beams."""

import msgspec
import numpy as np

from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.evaluation.lidar.scan import capture_turns, scan_in_rain
from gsrain_engine.evaluation.lidar.sensor import LidarSensor
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation

ROSETTE = LidarSensor(
    name="narrow rosette", elevations_deg=(0.0,), blind_m=1.0, clear_m=3.0, beam_mm=30.0, divergence_mrad=1.0
)


def test_its_receiver_holds_its_gain_back_and_ours_does(test_data):
    capture = open_capture(test_data / "weather/rainsense/torriential_rain/scene_6/case_000")
    turn = next(iter(capture_turns(capture, ROSETTE)))
    ranges = turn.beams.ranges_m[~turn.beams.untouched]
    assert len(ranges) > 6000 and np.min(ranges) > 6  # it saw no drop before the road begins
    rainfall = RainSimulation.start(RainSettings(intensity_mm_h=9.245))

    def false_returns(least):
        sensor = msgspec.structs.replace(turn.sensor, least_reflectance=least)
        return int(scan_in_rain(turn.beams, sensor, rainfall, turn.anchor_to_world).is_false.sum())

    assert false_returns(0.0) > 200
    assert false_returns(1e-4) < 10
    assert false_returns(ROSETTE.least_reflectance) == 0
