"""Opening of what a data set is made of: a scene, a recording or a scenario, by name or by value."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..datasets.capture import Capture
from ..datasets.open_source import open_source, source_hash
from ..safe_io.fingerprints import input_fingerprint
from ..scene.open import scene_hash
from ..scene.scene import Scene
from ..simulation.scenario import Scenario
from ..simulation.scenario_io import load_scenario, scenario_names, scenario_suffixes
from .captures import CaptureSource
from .scenes import ScenarioSource, SceneSource
from .source import DatasetChoice, DatasetSource


def open_dataset_input(name: str) -> Scene | Capture | Scenario:
    """Open a shipped scenario or a scenario file, a scene, or a recording. Raises ValueError with what is wrong."""
    path = Path(name)
    is_file = path.is_file() and path.suffix.lower() in scenario_suffixes()
    if name in scenario_names() or is_file:
        return load_scenario(name)
    return open_source(name)


def input_hashes(name: str, opened: Scene | Capture | Scenario) -> dict[str, str]:
    """Return hashes of the input of a name, and of the scene of a scenario."""
    if not isinstance(opened, Scenario):
        return {name: source_hash(name)}
    hashes = {opened.scene: scene_hash(opened.scene)}
    return hashes | ({name: input_fingerprint(Path(name))} if Path(name).is_file() else {})


def dataset_source(
    opened: Scene | Capture | Scenario,
    choice: DatasetChoice,
    scene: Scene | None = None,
    facts: Mapping[str, Any] | None = None,
) -> DatasetSource:
    """Return the source of a data set.

    Args:
        opened: A scene, a recording, or a scenario, which is driven here.
        choice: What of it is used.
        scene: Scene of the scenario.
        facts: Plain values on which the pictures depend, too, such as hashes of inputs: others make another data set.

    Raises:
        ValueError: For a source without pictures, for cameras that it lacks, and for an unknown unit of length.
    """
    settings = {"width_px": choice.width_px, "lidar": None if choice.sensor is None else choice.sensor.name}
    about = settings | dict(facts or {})
    if isinstance(opened, Capture):
        return CaptureSource(opened, choice, about)
    if isinstance(opened, Scene):
        return SceneSource(opened, choice, about)
    if scene is None:
        raise ValueError(f"scenario {opened.name}: expected its scene {opened.scene}")
    return ScenarioSource(opened, scene, choice, about)
