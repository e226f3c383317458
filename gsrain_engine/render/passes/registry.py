"""The passes of a picture, in their order."""

from .base import Pass
from .glass import Glass
from .lamp_pools import LampPools
from .medium import Medium
from .mirror import MirrorPass
from .rings import Rings
from .scene_items import SceneItems
from .sensor import SensorPass
from .splashes import SplashPass
from .spray import Spray
from .streaks import Streaks

PASSES: tuple[Pass, ...] = (
    SceneItems(), LampPools(), Rings(), MirrorPass(), Streaks(), Medium(), SplashPass(), Spray(), Glass(), SensorPass(),
)  # fmt: skip
"""Statistics, attribution, provenance and the page's list of what it leaves out have these names."""
