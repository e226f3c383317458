"""Readers of OpenSCENARIO files that are tried with damaged ones."""

from pathlib import Path

from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_extras.openscenario.writer import write_openscenario
from small_scene import small_scene
from tests.fuzz.mutations import damaged_text
from tests.fuzz.reader import Reader
from tests.fuzz.settings_readers import assert_finite

from .test_openscenario import foreign, scenario


def _exported(folder: Path) -> Path:
    write_openscenario(folder / "ours.xosc", scenario(), small_scene())
    (folder / "ours.xodr").unlink()
    return folder / "ours.xosc"


def _read_scenario(path: Path) -> None:
    assert_finite(load_scenario(path))


_XML = (("*.xosc", damaged_text),)

READERS = (
    Reader("openscenario", _exported, _read_scenario, ValueError, _XML),
    Reader("openscenario-foreign", foreign, _read_scenario, ValueError, _XML),
)
