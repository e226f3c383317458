"""Headlights and tail lights of vehicles, by the boxes of these."""

from typing import Annotated, Literal

from msgspec import Meta

from ..settings import Settings
from .lamps import Lamp
from .objects import is_vehicle
from .scene import Scene


class VehicleLamps(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Headlights and tail lights of the ego vehicle and of all actors that are motor vehicles.

    The defaults are a low beam of 4000 cd within a few degrees and a tail light of 10 cd (UNECE R 48, R 7), in pictures
    exposed so that 10 cd are 1 m2: 31 lx on a white wall are display white.
    """

    mount: Literal["vehicles"]
    headlight_m2: Annotated[float, Meta(ge=0, le=1e9)] = 400.0
    """Intensity of each headlight, as `Lamp.intensity_m2`."""
    tail_light_m2: Annotated[float, Meta(ge=0, le=1e9)] = 1.0
    """Intensity of each tail light."""

    def of(self, scene: Scene) -> list[Lamp]:
        """Lamps of the vehicles of a scene, each mounted on its own."""
        lamps: list[Lamp] = []
        if scene.ego is not None:
            lamps += self._pair("ego", EGO_SIZE_LWH_M, (_EGO_MIDDLE_M, 0.0, -_rig_height_m(scene)), 1.0)
        for actor in scene.actors:
            if is_vehicle(actor.class_name):
                lamps += self._pair(actor.id, actor.size_lwh, (0.0, 0.0, 0.0), 1 / scene.metres_per_unit)
        return lamps

    def _pair(
        self, mount: str, size_lwh: tuple[float, float, float], foot: tuple[float, float, float], unit: float
    ) -> list[Lamp]:
        """Lamps at the ends of a box whose bottom center is `foot`; `unit` is a meter in the units of both."""
        length, width, height = size_lwh
        x, y, z = foot
        front, back = min(0.45 * height, 0.75 * unit), min(0.6 * height, 0.95 * unit)
        sides = (("left", 0.38 * width), ("right", -0.38 * width)) if width > _NARROW_M * unit else (("", 0.0),)
        found: list[Lamp] = []
        for side, across in sides:
            found += [
                Lamp(
                    name=" ".join(filter(None, (mount, side, "headlight"))), mount=mount,
                    position=(x + length / 2, y + across, z + front), direction=(1.0, 0.0, -0.03),
                    color=_HEADLIGHT_COLOR, intensity_m2=self.headlight_m2, inner_deg=4.0, outer_deg=28.0,
                ),
                Lamp(
                    name=" ".join(filter(None, (mount, side, "tail light"))), mount=mount,
                    position=(x - length / 2, y + across, z + back), direction=(-1.0, 0.0, 0.0),
                    color=_TAIL_LIGHT_COLOR, intensity_m2=self.tail_light_m2, inner_deg=45.0, outer_deg=90.0,
                ),
            ]  # fmt: skip
        return found


EGO_SIZE_LWH_M = (4.6, 1.85, 1.5)
"""Size of an ego vehicle; scenes don't have one. The origin of its rig is above the rear axle."""

_EGO_MIDDLE_M = EGO_SIZE_LWH_M[0] / 2 - 1.0  # from the rear axle forward to the center of the body
_RIG_HEIGHT_M = 1.5
_NARROW_M = 1.2  # narrower vehicles have one lamp at each end
_HEADLIGHT_COLOR = (1.0, 0.93, 0.82)
_TAIL_LIGHT_COLOR = (1.0, 0.03, 0.02)


def _rig_height_m(scene: Scene) -> float:
    """Height of the ego's frame above the ground; 1.5 m if the scene does not tell it."""
    if scene.ego is None or scene.ground_m is None or not len(scene.ego.times):
        return _RIG_HEIGHT_M
    ego = scene.ego_to_world(float(scene.ego.times[0]))
    height_m = _RIG_HEIGHT_M if ego is None else float(ego[2, 3]) - scene.ground_m
    return height_m if 0.3 <= height_m <= 4 else _RIG_HEIGHT_M
