"""Closed-loop Gymnasium environments; the import registers `gsrain/Drive-v0` and `gsrain/DrivePlan-v0`."""

from .registration import register_environments

try:
    import gymnasium as _gymnasium
except ModuleNotFoundError as _error:
    raise ModuleNotFoundError("gymnasium is not installed: pip install 'gsrain[drive]'", name="gymnasium") from _error

assert _gymnasium is not None

register_environments()
