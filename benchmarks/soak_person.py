"""User of the window for hours, as a script that advances each frame: the same for a seed."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.floaters import FloaterRules
from gsrain_engine.editor.selection.candidates import combine_selection
from gsrain_engine.scene.flags import BitMask
from ui.commands.table import COMMANDS

_BY_NAME = {action.name: action for action in COMMANDS}
_ANSWERS = ("Don't save", "Replace", "Overwrite", "Later", "Go on", "OK")
"""Answers to the program's questions, the first that is offered."""
_PATIENCE_S = 300.0
_RATES = ("No rain", "Light 1.2 mm/h", "Paper 8.5 mm/h", "Heavy 12 mm/h")
_LOOKS = ("depth", "opacity", "splats")


class Person:
    """Opens scenes, plays, rains, edits, records, starts and stops jobs, saves, and opens again."""

    def __init__(self, editor: Editor, scenes: list[str], folder: Path, seed: int) -> None:
        self._session, self._scenes, self._folder = editor, scenes, folder
        self._random = np.random.default_rng(seed)
        self.cycles = 0
        self.doing = "beginning"
        self.problems: list[str] = []
        """Errors that the program has reported."""
        self.is_at_rest = False
        """True if no dialog is open and no job runs: figures of such moments can be compared."""

    def steps(self) -> Iterator[None]:
        """Go on with one step each frame; never ends."""
        while True:
            for scene in self._scenes:
                yield from self._sitting(scene)
            self.cycles += 1

    def look_after(self) -> None:
        """Answer what the program asks, and note what it complains of."""
        editor = self._session
        if editor.status.problem is not None:
            self.problems.append(f"cycle {self.cycles}, {self.doing}: {editor.status.problem}")
            editor.status.dismiss()
        if editor.status.question is not None:
            offered = {each.label: each for each in editor.status.question.answers}
            label = next((each for each in _ANSWERS if each in offered), editor.status.question.answers[-1].label)
            editor.status.answer(offered[label])

    def _sitting(self, scene: str) -> Iterator[None]:
        parts = [self._play, self._look, self._rain, self._edit, self._key, self._record, self._jobs, self._save]
        yield from self._open(scene)
        for number in self._random.permutation(len(parts) - 1):
            yield from self._at(parts[number])
        yield from self._at(self._save)
        yield from self._at(self._close)

    def _at(self, part: Callable[[], Iterator[None]]) -> Iterator[None]:
        self.doing = part.__name__.strip("_")
        yield from part()

    # Parts of a sitting

    def _open(self, scene: str) -> Iterator[None]:
        self.doing = f"open {Path(scene).name}"
        self._session.open(scene)
        yield from self._until(lambda: self._session.busy is None and self._session.scene.gaussian_count > 0)
        self._session.clock.playing = False

    def _play(self) -> Iterator[None]:
        clock = self._session.clock
        self._do("Play or pause")
        yield from self._for(3.0)
        clock.playing = False
        for share in self._random.random(8):
            low, high = self._session.span_s
            clock.seek(low + share * (high - low))
            yield

    def _look(self) -> Iterator[None]:
        navigation = self._session.navigation
        for turn in self._random.uniform(-0.2, 0.2, 12):
            navigation.heading += float(turn)
            navigation.position = navigation.position + self._random.uniform(-0.3, 0.3, 3)
            yield
        for look in _LOOKS:
            self._do(f"Mode: {look}")
            yield from self._frames(2)
        for split in ("clear | rainy", "before | after", "off"):
            self._session.view.split = split
            yield from self._frames(2)
        self._do("Go home")
        self._session.take_screenshot(self._folder)
        yield from self._until(lambda: self._session.screenshot is None)

    def _rain(self) -> Iterator[None]:
        editor = self._session
        self._do(str(self._random.choice(_RATES)))
        yield from self._frames(3)
        for rate in np.linspace(0, float(self._random.uniform(2, 30)), 15):  # one drag of the slider, one step of undo
            editor.document.change_rain("Intensity", "soak", intensity_mm_h=float(rate))
            yield
        editor.document.end_gesture()
        self._do("Shelter under roofs")
        yield from self._until(lambda: editor.busy is None)
        self._do("Shelter under roofs")
        self._do("Add passing shower")
        yield from self._frames(3)
        self._do("Undo")

    def _edit(self) -> Iterator[None]:
        editor = self._session
        for name in ("Hide selection", "Delete selection", "Separate selection"):
            chosen = {
                each.key: BitMask.of(self._random.random(len(each.gaussians)) < 0.02)
                for each in editor.document.scene.members
            }
            editor.document.edit("Select", combine_selection, chosen, "set")
            yield from self._frames(2)
            self._do(name)
            yield from self._frames(2)
        self._do("Invert selection")
        yield from self._frames(2)
        steps = int(self._random.integers(3, 6))
        for name in [*["Undo"] * steps, *["Redo"] * (steps - 1), "Show all", "Select none"]:
            self._do(name)
            yield from self._frames(2)

    def _key(self) -> Iterator[None]:
        self._do("Circle around target")
        yield from self._frames(2)
        self._do("Follow path")
        yield from self._frames(3)
        self._do("Follow path")
        self._do("Delete camera path")
        yield

    def _record(self) -> Iterator[None]:
        editor = self._session
        editor.render_queue.change(size_px=(192, 128), first_s=0.0, last_s=0.5, codec="auto")
        editor.render_queue.record_to(self._folder / str(self._random.choice(["clip.mp4", "frames"])))
        yield from self._frames(3)  # the question whether to replace
        if self._random.random() < 0.3:
            yield from self._for(2.0)
            self._cancel()
        yield from self._until(lambda: not editor.jobs.running)

    def _jobs(self) -> Iterator[None]:
        editor = self._session
        editor.floaters.find(FloaterRules())
        yield from self._until(lambda: not editor.jobs.running)
        self._do("Undo")
        editor.wet_look.preview()
        yield from self._for(float(self._random.uniform(1, 20)))
        self._cancel()
        if editor.rollouts.why_not is None:
            editor.rollouts.start()
            yield from self._for(float(self._random.uniform(2, 30)))
            self._cancel()
            editor.rollouts.close_all()
        editor.viewport.options.split = "off"

    def _save(self) -> Iterator[None]:
        editor = self._session
        editor.files.save_as(self._folder / "project")
        yield from self._until(lambda: editor.files.busy is None and editor.status.question is None)
        self._do("Paper 8.5 mm/h")
        yield from self._frames(2)
        self._do("Save")
        yield from self._until(lambda: editor.files.busy is None)
        self._do("Revert")
        yield from self._until(lambda: editor.busy is None)

    def _close(self) -> Iterator[None]:
        editor = self._session
        self._do("Close scene")
        yield from self._until(lambda: not editor.document.scene.members)
        editor.jobs.clear()
        yield from self._until(lambda: not editor.is_working and not editor.background.tasks)
        yield from self._for(3.0)  # the program gives memory back after a second
        self.is_at_rest = True
        yield
        self.is_at_rest = False

    # Means

    def _do(self, name: str) -> None:
        _BY_NAME[name].perform(self._session)

    def _cancel(self) -> None:
        for job in self._session.jobs.running:
            job.cancel()

    def _frames(self, count: int) -> Iterator[None]:
        for _ in range(count):
            yield

    def _for(self, seconds: float) -> Iterator[None]:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            yield

    def _until(self, condition: Callable[[], bool]) -> Iterator[None]:
        """Wait, but not for ever: what does not come is a problem, and the person goes on."""
        until = time.monotonic() + _PATIENCE_S
        while not condition():
            if time.monotonic() > until:
                waits = f"waited {_PATIENCE_S:g} s in vain"
                self.problems.append(f"cycle {self.cycles}, {self.doing}: {waits}; busy: {self._session.busy}")
                return
            yield
