"""The table of readers that are tried with damaged files; a new one is a row in one of these or in an extra's."""

from collections.abc import Iterator
from importlib import import_module

from .capture_readers import CAPTURE_READERS
from .disdrometer_readers import DISDROMETER_READERS
from .driving_readers import DRIVING_READERS
from .found import EXTRAS
from .network_readers import NETWORK_READERS
from .reader import Reader
from .scene_readers import SCENE_READERS
from .settings_readers import SETTINGS_READERS
from .turbo_readers import TURBO_READERS


def _tables() -> Iterator[tuple[Reader, ...]]:
    yield from (SCENE_READERS, CAPTURE_READERS, SETTINGS_READERS, DRIVING_READERS, DISDROMETER_READERS)
    yield from (NETWORK_READERS, TURBO_READERS)
    for each in sorted(EXTRAS.glob("*/readers.py")):
        yield import_module(f"tests.extras.{each.parent.name}.readers").READERS


READERS: dict[str, Reader] = {reader.name: reader for table in _tables() for reader in table}
"""By name."""
