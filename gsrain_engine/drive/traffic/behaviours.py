"""All behaviours that a scenario may name, by their `kind`."""

from .constant_velocity import ConstantVelocity

BehaviourSettings = ConstantVelocity
"""Settings of one of them; `begin(scene, start_s)` makes the rule itself."""
