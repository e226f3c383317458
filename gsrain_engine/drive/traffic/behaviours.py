"""All behaviours that a scenario may name, by their `kind`."""

from .brake import Brake
from .constant_velocity import ConstantVelocity
from .cut_in import CutIn
from .idm import IntelligentDriver
from .replay import Replay
from .scripted_track import OnTrack
from .stationary import Stationary

BehaviourSettings = ConstantVelocity | Stationary | IntelligentDriver | CutIn | Brake | OnTrack | Replay
"""Settings of one of them; `begin(scene, start_s)` makes the rule itself."""
