"""Factors of rain, which an attribution switches: what switches each off; rain, scene and friction of a coalition."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple

from msgspec import structs

from ...rain.settings import RainSettings
from ...rain.wetness import OVERCAST_MM_H, wetness
from ...scene.open import is_built_in_street
from .shapley import Coalition, coalitions_of

Friction = Literal["dry", "wet"]
"""Friction of a drive, as in `simulation.friction`."""
ALL, NO_FACTORS = "all", "none"
"""Words for all factors that a rain has, and for no attribution."""


@dataclass(frozen=True)
class Factor:
    """One part of what rain does to a picture or a drive."""

    name: str
    title: str
    off: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Settings of the rain that switch it off; none for the light, which belongs to the scene, and for friction, which
    belongs to the drive."""
    on: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Settings that switch it on in a rain that lacks it."""

    def __post_init__(self) -> None:
        if unknown := {*self.off, *self.on} - set(RainSettings.__struct_fields__):
            raise ValueError(f"factor {self.name}: rain has no setting {', '.join(sorted(unknown))}")


LIGHT = "light"
WET = "wet"
FRICTION = "friction"

FACTORS = (
    # Without streaks, the medium must not take their place: together they extinguish what all drops do.
    Factor("streaks", "streaks", {"streak_gain": 0.0}, {"streaks": True, "streak_gain": 1.0}),
    Factor("medium", "medium", {"haze": "none", "visibility_m": None}, {"haze": "medium"}),
    Factor(LIGHT, "overcast light"),
    Factor(WET, "wet look", {"wetness": 0.0}, {"wetness": None}),
    Factor("mirror", "mirror", {"mirror": False}, {"mirror": True}),
    Factor("splashes", "splashes and rings", {"splashes": False}, {"splashes": True}),
    Factor("spray", "spray", {"spray": False}, {"spray": True}),
    Factor("glass", "glass", {"glass": "none"}, {"glass": "windshield"}),
    Factor(FRICTION, "wet friction"),
)
"""All factors, in the order of tables and figures."""

_BY_NAME = {each.name: each for each in FACTORS}

ON_WET_GROUND = frozenset({LIGHT, WET, "mirror", "splashes", "spray"})
"""Factors that need a wet scene; light is of one, too, as both have one set of colors but on the street."""

_OVERCAST_TWINS = {None: "street:overcast", "street": "street:overcast"}
"""Scenes by name of which another has the light of rain without its water."""


def factor_names(*, of_drives: bool = True) -> tuple[str, ...]:
    """Names of all factors, or of those that pictures have."""
    return tuple(name for name in _BY_NAME if of_drives or name != FRICTION)


def title_of(name: str) -> str:
    return _BY_NAME[name].title


def overcast_twin(scene: str | None) -> str | None:
    """Name of the scene that has the dry colors of another one under clouds; None if there is none."""
    return _OVERCAST_TWINS.get(scene) if is_built_in_street(scene) else None


def is_attributed(names: Sequence[str]) -> bool:
    """Return whether a choice of factors asks for an attribution; raises ValueError for an unusable choice."""
    if tuple(names) in ((), (NO_FACTORS,)):
        return False
    check_factors(names)
    return True


def check_factors(names: Sequence[str]) -> None:
    """Raise ValueError for an unknown factor, or one that has no effect or no share of its own without another."""
    for name in names:
        if name != ALL and name not in _BY_NAME:
            raise ValueError(f"attribute {name}: expected {ALL}, or some of {', '.join(_BY_NAME)}")
        if name in ON_WET_GROUND and not {WET, ALL} & set(names):
            raise ValueError(f"attribute {name}: has a share only next to {WET}; name that, too")


@dataclass(frozen=True)
class RainFactors:
    """Rain as a sum of factors, and the coalitions of them."""

    rain: RainSettings
    """With all factors."""
    names: tuple[str, ...]
    twin: str | None
    """Scene with the light of this rain, dry."""
    friction: Friction | None = None
    """Of the drive with all factors; None for pictures."""

    @classmethod
    def of(
        cls,
        rain: RainSettings,
        names: Sequence[str],
        scene: str | None,
        lacking: Sequence[str] = (),
        friction: Friction | None = None,
    ) -> "RainFactors":
        """Take a rain apart.

        `names` are the factors of which the rain is to consist: others are switched off, absent ones on; "all" are
        those that it has. `scene` is the scene's name as `load_scene` takes it, `friction` that of a drive. Factors
        that can't act are left out: those `lacking` in the scene, light without a scene that has it alone, and what
        needs wet ground below 0.3 mm/h.
        """
        check_factors(names)
        twin, chosen = overcast_twin(scene), set(names)
        if ALL in chosen:
            chosen |= {each.name for each in FACTORS if each.name == LIGHT or _is_on(each, rain)}
            chosen |= {FRICTION} if friction == "wet" else set()
        for each in FACTORS:
            if each.name not in chosen and _is_on(each, rain):
                rain = structs.replace(rain, **each.off)
            elif each.name in names and not _is_on(each, rain):
                rain = structs.replace(rain, **each.on)
        for name in names:
            if name in lacking:
                raise ValueError(f"attribute {name}: {scene or 'the scene'} has none")
        if friction is None and FRICTION in names:
            raise ValueError(f"attribute {FRICTION}: pictures have none; drives do (gsrain sweep)")
        absent = set(lacking) if friction is not None else {*lacking, FRICTION}
        if friction is not None:
            friction = "wet" if FRICTION in chosen else "dry"
        is_wet = WET in chosen and WET not in absent
        if not is_wet or (wetness(rain.intensity_mm_h) if rain.wetness is None else rain.wetness) == 0:
            absent |= ON_WET_GROUND
        elif twin is None or rain.wetness is not None or rain.intensity_mm_h < OVERCAST_MM_H:
            absent.add(LIGHT)
        return cls(rain, tuple(each.name for each in FACTORS if each.name in chosen - absent), twin, friction)

    @cached_property
    def coalitions(self) -> dict[Coalition, Coalition]:
        """All coalitions, each with the one that is evaluated in its place, which has the same effect.

        Nothing on wet ground acts without it, and the wet colors contain the light.
        """
        light = {LIGHT}.intersection(self.names)
        return {
            present: present | light if WET in present else present - (ON_WET_GROUND - {LIGHT})
            for present in coalitions_of(self.names)
        }

    @property
    def evaluated(self) -> list[Coalition]:
        """The different coalitions, from none to all."""
        return sorted(set(self.coalitions.values()), key=lambda each: (len(each), [n not in each for n in self.names]))

    def weather(self, present: Coalition) -> "CoalitionWeather":
        """Return the rain and the scene with some factors."""
        if not present:
            return CoalitionWeather(clear_rain(self.rain), False, self.friction)
        rain = self.rain
        for each in self.names:
            if each not in present:
                rain = structs.replace(rain, **_BY_NAME[each].off)
        friction: Friction | None = self.friction if FRICTION in present or self.friction is None else "dry"
        return CoalitionWeather(rain, LIGHT in present and WET not in present, friction)


class CoalitionWeather(NamedTuple):
    """Rain, whether it falls in the scene that has the light of rain and is dry, and the friction of a drive."""

    rain: RainSettings
    in_twin: bool
    friction: Friction | None = None


def clear_rain(rain: RainSettings) -> RainSettings:
    """Return the settings of the clear scene: no rain, no fog, dry, nothing in front of the camera."""
    return structs.replace(rain.without_rain, glass="none")


def _is_on(factor: Factor, rain: RainSettings) -> bool:
    is_on = any(getattr(rain, name) != value for name, value in factor.off.items())
    return is_on and (factor.name != "streaks" or rain.streaks)
