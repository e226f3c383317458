"""Registration of the environments with Gymnasium.

Imports nothing else, because the import of gymnasium may call it.
"""

# Not `import gymnasium`: versions that load plugins do so before that module is complete.
from gymnasium.envs.registration import register, registry

CONTROL_ID, PLAN_ID = "gsrain/Drive-v0", "gsrain/DrivePlan-v0"
_CREATOR = "gsrain_engine.simulation.gymnasium.environment:DriveEnvironment"


def register_environments() -> None:
    """Register both environments: controls (acceleration and steering rate) or plan points as actions."""
    for id, action in ((CONTROL_ID, "control"), (PLAN_ID, "plan")):
        if id not in registry:
            register(id=id, entry_point=_CREATOR, kwargs={"action": action})
