"""Factors of rain, which an attribution switches: what switches each off; rain, scene and friction of a coalition."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from msgspec import structs

from ...rain.settings import RainSettings
from ...rain.wetness import OVERCAST_MM_H, SOFTENED_ABOVE_MM_H, wetness
from ...render.passes import registry
from ...render.passes.base import Factor
from ...scene.built_in import DEFAULT_SCENE, built_in_scene
from ...scene.open import is_built_in
from .shapley import Coalition, coalitions_of

Friction = Literal["dry", "wet"]
"""Friction of a drive, as in `simulation.friction`."""
ALL, NO_FACTORS = "all", "none"
"""Words for all factors that a rain has, and for no attribution."""


LIGHT = "light"
WET = "wet"
FRICTION = "friction"

_LIGHT = Factor(LIGHT, "overcast light", {"keep_light": True}, {"keep_light": False}, needs_wet_ground=True)
_WET = Factor(WET, "wet look", {"wetness": 0.0}, {"wetness": None}, needs_wet_ground=True)
_FRICTION = Factor(FRICTION, "wet friction")


def factors() -> dict[str, Factor]:
    """All factors by name, in the order of tables and figures: those of passes, of the scene's colors and of a drive.

    What needs wet ground comes after it; light does, too, as both have one set of colors but on the street.
    """
    of_passes = [each.factor for each in registry.PASSES if each.factor is not None]
    in_air = [each for each in of_passes if not each.needs_wet_ground and each.name != "glass"]
    last = [each for each in of_passes if each not in in_air]
    return {each.name: each for each in (*in_air, _LIGHT, _WET, *last, _FRICTION)}


def on_wet_ground() -> frozenset[str]:
    """Names of the factors that need a wet scene."""
    return frozenset(name for name, each in factors().items() if each.needs_wet_ground)


def factor_names(*, of_drives: bool = True) -> tuple[str, ...]:
    """Names of all factors, or of those that pictures have."""
    return tuple(name for name in factors() if of_drives or name != FRICTION)


def title_of(name: str) -> str:
    return factors()[name].title


def overcast_twin(scene: str | None) -> str | None:
    """Name of the scene that has the dry colors of another one under clouds; None if there is none."""
    built_in = built_in_scene(scene or DEFAULT_SCENE) if is_built_in(scene) else None
    return None if built_in is None else built_in.overcast_twin


def is_attributed(names: Sequence[str]) -> bool:
    """Return whether a choice of factors asks for an attribution; raises ValueError for an unusable choice."""
    if tuple(names) in ((), (NO_FACTORS,)):
        return False
    check_factors(names)
    return True


def check_factors(names: Sequence[str]) -> None:
    """Raise ValueError for an unknown factor, or one that has no effect or no share of its own without another."""
    for name in names:
        if name != ALL and name not in factors():
            raise ValueError(f"attribute {name}: expected {ALL}, or some of {', '.join(factors())}")
        if name in on_wet_ground() and not {WET, ALL} & set(names):
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
        needs wet ground below 0.3 mm/h. Photographs lack all on wet ground; their light is softened from 2.5 mm/h on.
        """
        check_factors(names)
        twin, chosen = overcast_twin(scene), set(names)
        if ALL in chosen:
            chosen |= {each.name for each in factors().values() if each.name == LIGHT or _is_on(each, rain)}
            chosen |= {FRICTION} if friction == "wet" else set()
        on_photographs = WET in lacking and LIGHT not in lacking
        for each in factors().values():
            if each.name == LIGHT and not on_photographs:
                continue
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
        if on_photographs:
            absent |= on_wet_ground() - {LIGHT}
            if rain.keep_light or rain.intensity_mm_h <= SOFTENED_ABOVE_MM_H:
                absent.add(LIGHT)
        elif not is_wet or (wetness(rain.intensity_mm_h) if rain.wetness is None else rain.wetness) == 0:
            absent |= on_wet_ground()
        elif twin is None or rain.wetness is not None or rain.intensity_mm_h < OVERCAST_MM_H:
            absent.add(LIGHT)
        return cls(rain, tuple(name for name in factors() if name in chosen - absent), twin, friction)

    @cached_property
    def coalitions(self) -> dict[Coalition, Coalition]:
        """All coalitions, each with the one that is evaluated in its place, which has the same effect.

        Nothing on wet ground acts without it, and the wet colors contain the light.
        """
        light = {LIGHT}.intersection(self.names)
        return {
            present: present | light if WET in present else present - (on_wet_ground() - {LIGHT})
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
                rain = structs.replace(rain, **factors()[each].off)
        without = frozenset(name for name, each in factors().items() if _is_pass_alone(each)) - present
        friction: Friction | None = self.friction if FRICTION in present or self.friction is None else "dry"
        return CoalitionWeather(rain, LIGHT in present and WET not in present, friction, without)


class CoalitionWeather(NamedTuple):
    """Rain, whether it falls in the scene that has the light of rain and is dry, and the friction of a drive."""

    rain: RainSettings
    in_twin: bool
    friction: Friction | None = None
    without: frozenset[str] = frozenset()
    """Passes that are left out by their names, as no setting does."""


def clear_rain(rain: RainSettings) -> RainSettings:
    """Return the settings of the clear scene: no rain, no fog, dry, nothing in front of the camera."""
    return structs.replace(rain.without_rain, glass="none")


def _is_pass_alone(factor: Factor) -> bool:
    """Return whether a factor is a pass that no setting switches off."""
    return not factor.off and any(each.name == factor.name for each in registry.PASSES)


def _is_on(factor: Factor, rain: RainSettings) -> bool:
    if _is_pass_alone(factor):
        return True
    is_on = any(getattr(rain, name) != value for name, value in factor.off.items())
    return is_on and (factor.name != "streaks" or rain.streaks)
