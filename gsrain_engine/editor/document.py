"""The document (scene, rain, keyframes), its undo history, and the edits that change it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import msgspec

from ..fields import field_of
from ..rain.keyframes import NO_KEYFRAMES, RainKeyframes
from ..rain.settings import RainSettings, RegionBox
from ..scene.scene import Scene, is_single_object
from .clock import PlaybackClock
from .status import StatusBus


@dataclass(frozen=True, slots=True, eq=False)
class DocumentState:
    """State that the user edits and that undo restores."""

    scene: Scene
    rain: RainSettings
    keyframes: RainKeyframes = NO_KEYFRAMES
    origin: str = ""
    """Job or program that has made the scene anew, which then has no folder; "" for the one that was opened."""

    def equals(self, other: "DocumentState") -> bool:
        """Return whether both have the same scene object, and equal rain and keyframes."""
        return self.scene is other.scene and self.rain == other.rain and self.keyframes == other.keyframes

    def rain_change(self, after: "DocumentState") -> str:
        """Old and new value of the rain setting in which a later document differs: "8.5 -> 13 mm/h".

        "" if none or several differ, if it is no single value, or if it is on or off, which the step's label tells.
        """
        if self.rain == after.rain:
            return ""
        old, new = (msgspec.structs.asdict(each.rain) for each in (self, after))
        names = [name for name in new if old[name] != new[name]]
        if names and set(names) <= {"wind_speed_m_s", "wind_from_deg"}:
            winds = (
                f"{each.rain.wind_speed_m_s:.3g} m/s, {each.rain.wind_from_deg:.0f}\u00b0" for each in (self, after)
            )
            return " -> ".join(winds)
        if len(names) != 1 or isinstance(new[names[0]], bool):
            return ""
        if not isinstance(old[names[0]] or new[names[0]], str | float | int):
            return ""
        setting = field_of(RainSettings, names[0])
        words = " -> ".join(setting.value_text(each[names[0]]) for each in (old, new))
        return f"{words} {setting.unit}".rstrip()


# Undo
# States are immutable values, so a step costs a reference.


class Recipe(NamedTuple):
    """A function of the scene, with arguments by name, that makes what was computed in the background."""

    change: Callable[..., Scene]
    arguments: Mapping[str, Any]


@dataclass(slots=True)
class Step:
    """A step of the history: the document after it, and the pure function with its arguments that made it."""

    label: str
    document: DocumentState
    of: Literal["scene", "keyframes", "document"] = "document"
    """Argument and result of `change`: a part of the document, or all of it."""
    change: Callable[..., Any] | None = None
    """None for the first step, an opened document."""
    arguments: tuple[Any, ...] = ()
    """Arguments of `change` after the first."""
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Keyword arguments of `change`."""
    gesture: str | None = None
    """Name of the running drag; further changes by the same gesture belong to the same step."""
    recipe: Recipe | None = None
    """Makes the same as `change`, whose arguments are a result of background work; None for any other step."""
    origin: str | None = None
    """Origin of the document from here on; None changes nothing."""

    def applied_to(self, before: DocumentState) -> DocumentState:
        """Apply the change to another document."""
        if self.change is None:
            return before
        if self.of == "document":
            return self.change(before, *self.arguments, **self.options)
        changed = self.change(getattr(before, self.of), *self.arguments, **self.options)
        after = replace(before, **{self.of: changed})
        if after.scene.metres_per_unit != before.scene.metres_per_unit:
            after = replace(after, rain=rain_around(after.scene, after.rain))
        return after if self.origin is None else replace(after, origin=self.origin)


class History:
    """Undo steps and a cursor at the present one."""

    def __init__(self, document: DocumentState) -> None:
        """Start with an opened document."""
        self.steps = [Step("Opened", document)]
        """Oldest first."""
        self.cursor = 0

    @property
    def labels(self) -> list[str]:
        return [step.label for step in self.steps]

    @property
    def step(self) -> Step:
        """The present step."""
        return self.steps[self.cursor]

    @property
    def present(self) -> DocumentState:
        return self.step.document

    @property
    def previous(self) -> DocumentState:
        """Document before the last step; at the start the present one."""
        return self.steps[max(0, self.cursor - 1)].document

    @property
    def undo_label(self) -> str | None:
        """Label of the step that undo reverts; None at the start."""
        return self.step.label if self.cursor > 0 else None

    @property
    def redo_label(self) -> str | None:
        """Label of the step that redo restores; None at the end."""
        return self.steps[self.cursor + 1].label if self.cursor + 1 < len(self.steps) else None

    def continues(self, gesture: str | None) -> bool:
        """Return whether the present step belongs to a gesture that has not ended."""
        return gesture is not None and self.step.gesture == gesture

    def record(self, step: Step) -> None:
        """Append a step and drop the redo steps. A continuing gesture replaces its own last step."""
        self.cursor += not self.continues(step.gesture)
        self.steps[self.cursor :] = [step]

    def end_gesture(self) -> None:
        """End the gesture, so that the next change is a step of its own."""
        self.step.gesture = None

    def go_to(self, step: int) -> None:
        """Go to a step, at most to the first or the last one."""
        self.cursor = min(max(step, 0), len(self.steps) - 1)


# Edited document


class Document:
    """The present scene, rain and keyframes, their history, and the only functions that change them.

    Each change is a pure function with arguments, recorded with its step. Changes of one gesture (a drag) make one
    step: each applies to the document before the gesture, so that the last one alone is the step. Call `end_gesture`
    when it ends. A `ValueError` of a function is reported, and nothing changes.
    """

    def __init__(self, state: DocumentState, clock: PlaybackClock, status: StatusBus) -> None:
        """`clock` is the time at which rain with keyframes is changed."""
        self.followers: list[Callable[[DocumentState, DocumentState], object]] = []
        """Functions to call with the old and the new document after each edit, undo, redo and opening."""
        self.history = History(state)
        self._clock, self._status = clock, status

    @property
    def state(self) -> DocumentState:
        return self.history.present

    @property
    def scene(self) -> Scene:
        return self.state.scene

    @property
    def rain(self) -> RainSettings:
        return self.state.rain

    @property
    def keyframes(self) -> RainKeyframes:
        return self.state.keyframes

    @property
    def rain_now(self) -> RainSettings:
        """Rain at the present time: interpolated where a field has keyframes, constant elsewhere."""
        return self.keyframes.rain_at(self.rain, self._clock.time_s)

    def open(self, state: DocumentState) -> None:
        """Replace the document by another one, with a history of its own."""
        before, self.history = self.state, History(state)
        self._notify(before)

    def edit(
        self,
        label: str | Callable[[Scene, Scene], str],
        change: Callable[..., Scene],
        *arguments: Any,
        gesture: str | None = None,
        recipe: Recipe | None = None,
        origin: str | None = None,
        **options: Any,
    ) -> bool:
        """Set the scene that `change(scene, *arguments, **options)` returns; return whether it is another one.

        `label` may be a function of the old and the new scene. With `origin`, the scene is made anew by a job of that
        name, and belongs to no folder until it is saved.
        """
        return self._apply(label, Step("", self.state, "scene", change, arguments, options, gesture, recipe, origin))

    def edit_keyframes(
        self,
        label: str,
        change: Callable[..., RainKeyframes],
        *arguments: Any,
        gesture: str | None = None,
        **options: Any,
    ) -> bool:
        """Set the rain keyframes that a function returns, as `edit` does; drops in the air keep their positions."""
        return self._apply(label, Step("", self.state, "keyframes", change, arguments, options, gesture))

    def change_rain(self, label: str, gesture: str | None = None, **fields: Any) -> None:
        """Change fields of the rain; drops in the air continue from their positions.

        A field with keyframes gets a keyframe at the present time, or at the start of the running gesture.
        """
        at_s = self.history.step.arguments[0] if self.history.continues(gesture) else self._clock.time_s
        self._apply(label, Step("", self.state, "document", with_rain, (at_s,), fields, gesture))

    def perform(self, step: Step) -> bool:
        """Make a step whose label, change and arguments are known; return whether the document is another one."""
        return self._apply(step.label, step)

    def set_contents(self, label: str, scene: Scene, rain: RainSettings, gesture: str) -> None:
        """Set scene and rain of another program."""
        self._apply(label, Step("", self.state, "document", with_contents, (scene, rain), {}, gesture))

    def end_gesture(self) -> None:
        self.history.end_gesture()

    def undo(self) -> None:
        self.go_to_step(self.history.cursor - 1)

    def redo(self) -> None:
        self.go_to_step(self.history.cursor + 1)

    def go_to_step(self, step: int) -> None:
        """Go to a step of the history, backward or forward."""
        before = self.state
        self.history.go_to(step)
        self._notify(before)

    def _apply(self, label: str | Callable[[Scene, Scene], str], step: Step) -> bool:
        before = self.state
        start = self.history.previous if self.history.continues(step.gesture) else before
        try:
            after = step.applied_to(start)
        except ValueError as error:
            self._status.report(error)
            return False
        if after.equals(before):
            return False
        label = label if isinstance(label, str) else label(start.scene, after.scene)
        self.history.record(replace(step, label=label, document=after))
        self._notify(before)
        return True

    def _notify(self, before: DocumentState) -> None:
        for follower in self.followers:
            follower(before, self.state)


def with_rain(state: DocumentState, at_s: float = 0.0, **fields: Any) -> DocumentState:
    """Change fields of the rain; those with keyframes get one at a time in seconds."""
    rain = msgspec.structs.replace(state.rain, **fields)
    if not fields.keys().isdisjoint(("wind_speed_m_s", "wind_from_deg")):
        fields = fields | {"wind_m_s": rain.wind_vector_m_s}
    keyed = {name: value for name, value in fields.items() if state.keyframes.is_keyed(name) and value is not None}
    keyframes = state.keyframes.with_key(at_s, **keyed) if keyed else state.keyframes
    return replace(state, rain=rain, keyframes=keyframes)


OBJECT_AIR = RegionBox(minimum_m=(-10.0, -10.0, -10.0), maximum_m=(10.0, 10.0, 10.0))
"""Region of the haze around a single object, whose background stays dark so that rain shows before it."""


def rain_around(scene: Scene, rain: RainSettings) -> RainSettings:
    """Rain for a scene that has none of its own: around a single object the haze ends, around others it does not.

    A region of the haze that is neither stays.
    """
    if rain.haze_region not in (None, OBJECT_AIR):
        return rain
    air = OBJECT_AIR if scene.members and is_single_object(scene) else None
    return msgspec.structs.replace(rain, haze_region=air)


def with_preset(rain: RainSettings, preset: RainSettings) -> RainSettings:
    """Rain with a preset: one of an intensity sets that alone, any other one all settings."""
    is_intensity = msgspec.structs.replace(preset, intensity_mm_h=RainSettings().intensity_mm_h) == RainSettings()
    return msgspec.structs.replace(rain, intensity_mm_h=preset.intensity_mm_h) if is_intensity else preset


def with_contents(state: DocumentState, scene: Scene, rain: RainSettings) -> DocumentState:
    """Set scene and rain; another scene is that of a program, with no folder of its own."""
    return replace(state, scene=scene, rain=rain, origin=state.origin if scene is state.scene else "program")
