"""Opening of what a data set is made of: a scene, a recording or a scenario, by name or by value."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..datasets.capture import Capture
from ..datasets.open_source import open_source, source_hash
from ..evaluation.lidar.sensor import LidarSensor
from ..safe_io.fingerprints import input_fingerprint
from ..scene.open import scene_hash
from ..scene.scene import Scene
from ..simulation.scenario import Scenario
from ..simulation.scenario_io import load_scenario, scenario_names, scenario_suffixes
from .captures import CaptureSource
from .scenes import DEFAULT_RATE_HZ, ScenarioSource, SceneSource
from .source import DatasetSource


@dataclass(frozen=True, kw_only=True)
class DatasetChoice:
    """Parts of a source that become the data set."""

    cameras: tuple[str, ...] = ()
    """Names; none are those of the first rig, of a recording all."""
    rate_hz: float | None = None
    """Moments per second; None is `DEFAULT_RATE_HZ`, of a recording all."""
    moments: int | None = None
    """Maximum number of moments, from the first."""
    width_px: int | None = None
    """Width of the pictures; None is the cameras' own."""
    sensor: LidarSensor | None = None
    """Lidar on the roof, or that of the recording; None leaves it out."""


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
    options = {
        "cameras": choice.cameras, "moments": choice.moments, "width_px": choice.width_px, "sensor": choice.sensor,
    }  # fmt: skip
    settings = {"width_px": choice.width_px, "lidar": None if choice.sensor is None else choice.sensor.name}
    options["facts"] = settings | dict(facts or {})
    if isinstance(opened, Capture):
        return CaptureSource(opened, rate_hz=choice.rate_hz, **options)
    rate_hz = choice.rate_hz or DEFAULT_RATE_HZ
    if isinstance(opened, Scene):
        return SceneSource(opened, rate_hz=rate_hz, **options)
    if scene is None:
        raise ValueError(f"scenario {opened.name}: expected its scene {opened.scene}")
    return ScenarioSource(opened, scene, rate_hz=rate_hz, **options)
