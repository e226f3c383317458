"""The edited document (scene, rain, weather) and its undo history."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import msgspec

from ..rain.keyframes import NO_KEYFRAMES, RainKeyframes
from ..rain.settings import RainSettings
from ..scene.scene import Scene
from .timeline import PlaybackClock


@dataclass(frozen=True, slots=True, eq=False)
class Document:
    """State that the user edits and that undo restores."""

    scene: Scene
    rain: RainSettings
    weather: RainKeyframes = NO_KEYFRAMES


# Undo
# Documents are immutable values, so a step costs a reference.


@dataclass(slots=True)
class _Step:
    label: str
    document: Document
    gesture: str | None = None
    """Name of the running drag; further changes by the same gesture belong to the same step."""


class History:
    """Undo steps and a cursor at the present one."""

    def __init__(self, document: Document) -> None:
        """Start with an opened document."""
        self._steps = [_Step("Open", document)]
        self.cursor = 0

    @property
    def labels(self) -> list[str]:
        """Oldest first."""
        return [step.label for step in self._steps]

    @property
    def present(self) -> Document:
        return self._steps[self.cursor].document

    @property
    def previous(self) -> Document:
        """Document before the last step; at the start the present one."""
        return self._steps[max(0, self.cursor - 1)].document

    @property
    def gesture(self) -> str | None:
        """Gesture that the present step belongs to, while it continues."""
        return self._steps[self.cursor].gesture

    @property
    def undo_label(self) -> str | None:
        """Label of the step that undo reverts; None at the start."""
        return self._steps[self.cursor].label if self.cursor > 0 else None

    @property
    def redo_label(self) -> str | None:
        """Label of the step that redo restores; None at the end."""
        return self._steps[self.cursor + 1].label if self.cursor + 1 < len(self._steps) else None

    def record(self, label: str, document: Document, gesture: str | None = None) -> None:
        """Append a document and drop the redo steps. A continuing gesture replaces its own last step."""
        step = self._steps[self.cursor]
        if gesture is not None and step.gesture == gesture:
            step.document = document
        else:
            self._steps[self.cursor + 1 :] = [_Step(label, document, gesture)]
            self.cursor += 1

    def end_gesture(self) -> None:
        """End the gesture, so that the next change is a step of its own."""
        self._steps[self.cursor].gesture = None

    def go_to(self, step: int) -> Document:
        """Go to a step, at most to the first or the last one."""
        self.cursor = min(max(step, 0), len(self._steps) - 1)
        return self.present


# Edited document

logger = logging.getLogger("gsrain")


class EditedDocument:
    """The present document and the methods that change it. Subclasses update derived state in `_follow_document`."""

    def __init__(self, document: Document, clock: PlaybackClock) -> None:
        self.clock = clock
        self.history = History(document)
        self.problem: str | None = None
        """Last error, in one sentence; the viewport shows it until it is closed or a scene is opened."""
        self._key_moment: tuple[str | None, float] = None, 0.0
        """Running gesture and the time at which it sets its keyframes."""

    def _follow_document(self) -> None:
        raise NotImplementedError

    @property
    def scene(self) -> Scene:
        return self.history.present.scene

    @property
    def rain(self) -> RainSettings:
        return self.history.present.rain

    def change_rain(self, label: str, gesture: str | None = None, **fields: object) -> None:
        """Change fields of the rain. Changes of one gesture (a drag) make one step; call `end_gesture` when it ends.

        A field with keyframes gets a keyframe at the present time, or at the start of the running gesture.
        """
        if gesture is None or gesture != self._key_moment[0]:
            self._key_moment = gesture, self.clock.time_s
        at_s = self._key_moment[1]
        keyed = {name: value for name, value in fields.items() if self.weather.is_keyed(name) and value is not None}
        rain = msgspec.structs.replace(self.rain, **fields)
        weather = self.weather.with_key(at_s, **keyed) if keyed else self.weather
        self.set_rain(label, rain, gesture, weather)

    @property
    def weather(self) -> RainKeyframes:
        return self.history.present.weather

    @property
    def rain_now(self) -> RainSettings:
        """Rain at the present time: interpolated where a field has keyframes, constant elsewhere."""
        return self.weather.rain_at(self.rain, self.clock.time_s)

    def set_weather(self, label: str, weather: RainKeyframes, gesture: str | None = None) -> None:
        """Set the rain keyframes; drops in the air continue from their positions."""
        self.set_rain(label, self.rain, gesture, weather)

    def set_rain(
        self, label: str, rain: RainSettings, gesture: str | None = None, weather: RainKeyframes | None = None
    ) -> None:
        """Set the rain, and keyframes if given; drops in the air continue from their positions."""
        present, weather = self.history.present, weather or self.weather
        if rain != present.rain or weather != present.weather:
            self.history.record(label, replace(present, rain=rain, weather=weather), gesture)
            self._follow_document()

    def set_scene(self, label: str, scene: Scene, gesture: str | None = None) -> None:
        self.history.record(label, replace(self.history.present, scene=scene), gesture)
        self._follow_document()

    def edit(self, label: str, change: Callable[..., Scene], *arguments: object, gesture: str | None = None) -> None:
        """Set the scene that `change` returns; a `ValueError` is logged and set as `problem`."""
        try:
            changed = change(self.scene, *arguments)
        except ValueError as error:
            self.report_problem(str(error))
        else:
            self.set_scene(label, changed, gesture)

    def show_member(self, key: str, visible: bool) -> None:
        verb = "Show" if visible else "Hide"
        self.set_scene(f"{verb} {self.scene.member(key).name}", self.scene.with_member(key, visible=visible))

    def end_gesture(self) -> None:
        self._key_moment = None, 0.0
        self.history.end_gesture()

    def undo(self) -> None:
        self.go_to_step(self.history.cursor - 1)

    def redo(self) -> None:
        self.go_to_step(self.history.cursor + 1)

    def go_to_step(self, step: int) -> None:
        """Go to a step of the history, backward or forward."""
        self.history.go_to(step)
        self._follow_document()

    def report_problem(self, problem: str) -> None:
        """Log an error and set it as `problem`."""
        self.problem = problem
        logger.error("%s", problem)
