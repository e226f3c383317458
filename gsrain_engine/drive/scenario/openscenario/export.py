"""Writes a scenario down as OpenSCENARIO XML 1.2, with the road that it takes place on as OpenDRIVE beside it."""

import importlib.util
from pathlib import Path

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.scene.scene import Scene

from ..scenario import Scenario


def write_openscenario(path: Path, scenario: Scenario, scene: Scene) -> None:
    """Write `path` (.xosc), and beside it the road of the same name (.xodr). The same scenario gives the same bytes.

    Places and headings are those in the world of the scene, metres; the ego vehicle is called Ego. Rain stands in the
    file as precipitation in mm/h, with its visual range as fog; wet roads are marked, not made slippery. What
    OpenSCENARIO can say about road users is said in its own words: teleports, speeds, lane changes (its cubic, for our
    quintic), trajectories, triggers by time, gap and time to collision. Car following becomes a controller with its
    parameters as properties. `read_openscenario` reads all of it back; what only concerns us (model, rig, start in the
    recorded drive) stands in properties called `gsrain.*`.

    Raises ValueError as a simulation does where the scene lacks what the scenario needs, and ModuleNotFoundError, with
    what to install, without the package scenariogeneration.
    """
    if importlib.util.find_spec("scenariogeneration") is None:
        raise ModuleNotFoundError(
            "writing OpenSCENARIO needs scenariogeneration: pip install 'gsrain[drive]'", name="scenariogeneration"
        )
    from .document import document_xml
    from .road import road_xml

    road = path.with_suffix(".xodr")
    written = {road: road_xml(scenario, scene), path: document_xml(scenario, scene, road.name)}
    for each, text in written.items():
        with whole_file(each) as beside:
            beside.write_text(text, encoding="utf-8")
