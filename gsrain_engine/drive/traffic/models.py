"""What road users of a scenario look like, by the name of a model."""

from pathlib import Path

from gsrain_engine.scene.scene import Scene

from .built_in_vehicles import PAINTS, built_in_vehicle, vehicle_names
from .look import UserLook, scaled
from .model_files import model_of_file

__all__ = ["UserLook", "scaled", "user_look"]

ACTOR = "actor:"
"""How the name of a model begins that is one of the scene's actors; its id follows."""


def user_look(model: str, scene: Scene) -> UserLook:
    """Make a model: a built-in vehicle, also with a paint (saloon, van/red, truck); actor:ID of the scene; or a file.

    Raises ValueError, with the model's name, for what there is not.
    """
    built_in = built_in_vehicle(model)
    if built_in is not None:
        return built_in
    if model.startswith(ACTOR):
        return _actor_look(model.removeprefix(ACTOR), scene)
    path = Path(model)
    if not path.is_file():
        known = ", ".join([*vehicle_names(), *(f"{ACTOR}{each.id}" for each in scene.actors)])
        paints = ", ".join(PAINTS)
        raise ValueError(f"model {model}: no such file, and none of {known} (a paint may follow: /{paints})")
    return model_of_file(path)


def _actor_look(id: str, scene: Scene) -> UserLook:
    for actor in scene.actors:
        if actor.id == id:
            unit = scene.metres_per_unit
            length, width, height = (unit * side for side in actor.size_lwh)
            return UserLook(scaled(actor.gaussians, unit), (length, width, height))
    raise ValueError(f"model {ACTOR}{id}: scene {scene.name!r} has no such actor")
