"""The table of readers that are tried with damaged files; a new one is a row in one of these."""

from .capture_readers import CAPTURE_READERS
from .disdrometer_readers import DISDROMETER_READERS
from .driving_readers import DRIVING_READERS
from .network_readers import NETWORK_READERS
from .reader import Reader
from .scene_readers import SCENE_READERS
from .settings_readers import SETTINGS_READERS
from .turbo_readers import TURBO_READERS

_TABLES = (
    SCENE_READERS, CAPTURE_READERS, SETTINGS_READERS, DRIVING_READERS, DISDROMETER_READERS, NETWORK_READERS,
    TURBO_READERS,
)  # fmt: skip

READERS: dict[str, Reader] = {reader.name: reader for table in _TABLES for reader in table}
"""By name."""
