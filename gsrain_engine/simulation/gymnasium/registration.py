"""Makes the environments known to gymnasium; imports nothing else, for it may be called by the import of gymnasium."""

# Not `import gymnasium`: versions that load plug-ins do so before that module is whole.
from gymnasium.envs.registration import register, registry

CONTROL_ID, PLAN_ID = "gsrain/Drive-v0", "gsrain/DrivePlan-v0"

_CREATOR = "gsrain_engine.simulation.gymnasium.environment:DriveEnvironment"


def register_environments() -> None:
    """Register both, by what an action is: acceleration and steering rate, or the points of a plan."""
    for id, action in ((CONTROL_ID, "control"), (PLAN_ID, "plan")):
        if id not in registry:
            register(id=id, entry_point=_CREATOR, kwargs={"action": action})
