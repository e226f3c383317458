"""Detection of a car that cuts in, and lidar returns, with its spray and without: recall over the time of the maneuver."""

import argparse
import json
from pathlib import Path

import msgspec
import numpy as np
from PIL import Image

from gsrain_engine.backends import open_renderer
from gsrain_engine.evaluation.detection.detector import open_detector
from gsrain_engine.evaluation.lidar.scan import ReturnOutcome, scan_in_rain, scene_turns
from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.open import load_sorted_scene
from gsrain_engine.simulation.agents.base import SensorRequirements
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.simulation.simulation import Simulation
from gsrain_engine.simulation.vehicle import Control
from gsrain_engine.water.spray import spray_of
