"""One person's afternoon in the window, in two sittings; between them the program is killed.

`python whole_session.py first|second FOLDER`, under a display. Nothing but mouse, keys and dialogs is used.
"""

import os
import sys
import time
from pathlib import Path

import numpy as np

from gsrain_engine.compile_cache import use_kernel_cache
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.transform import pivot
from gsrain_engine.scene.scene import Scene
from ui.commands.keys import chord
from ui.window import begin_editor
from window_driver import Driver, imgui

KEY = imgui.Key
CTRL, SHIFT = KEY.mod_ctrl, KEY.mod_shift


class Person(Driver):
    """Hands and eyes."""

    def __init__(self, folder, editor):
        super().__init__(folder, Scene("no scene"))
        self.editor = editor

    def say(self, *words):
        print("\n", *words, flush=True)  # a line of its own: the test engine colors what it prints

    def type_into(self, dialog, text):
        """Type a file's name into a dialog, and press Enter."""
        self.frames(4)
        self.ctx.item_click(f"//{dialog}/##name")
        self.ctx.key_chars_replace_enter(text)
        self.frames(4)

    def answer(self, title, label):
        """Answer a question of the program, if it asks."""
        self.frames(4)
        if self.editor.status.question is not None and self.editor.status.question.title == title:
            self.ctx.item_click(f"//{title}/{label}")
            self.frames(4)

    def is_idle(self):
        return self.editor.busy is None and not self.editor.jobs.running and self.editor.viewport.staged is None


def first(folder, plant):
    """Everything up to the kill."""
    person = Person(folder, Editor())
    editor = person.editor

    def script():
        person.click("//View/###Play")  # time stands still
        person.press(chord(CTRL, KEY.o))
        person.type_into("Open a scene", str(plant))
        person.until(lambda: editor.document.scene.name == "plant" and person.is_idle(), 100_000)
        count = editor.document.scene.gaussian_count
        person.say("opened", count)

        person.press(KEY.m)  # measure the pot, and say that it is 20 cm wide
        person.click_at(person.at(0.45, 0.75))
        person.click_at(person.at(0.55, 0.75))
        before = editor.document.scene.metres_per_unit
        person.ctx.item_input_value("//View/**/##true length", 0.2)
        person.ctx.item_click("//View/**/Set scale")
        person.frames(3)
        person.say("scale", editor.document.scene.metres_per_unit / before)
        person.press(KEY.m)
        person.press(KEY.f)

        person.point_at(person.at(0.5, 0.5))
        person.press(KEY.l)
        around = np.linspace(0, 2 * np.pi, 24)
        person.stroke(*(person.at(0.5 + 0.3 * np.cos(a), 0.85 + 0.16 * np.sin(a)) for a in around))
        selected = sum(each.marks.selected.size for each in editor.document.scene.members if each.marks.selected)
        person.press(KEY.delete)
        person.say("deleted", selected, count - editor.document.scene.gaussian_count)
        person.press(chord(CTRL, KEY.z))
        person.say("undone", count - editor.document.scene.gaussian_count)
        person.press(chord(CTRL, KEY.y))
        person.say("redone", count - editor.document.scene.gaussian_count)
        person.press(KEY.escape)

        person.press(chord(CTRL, SHIFT, KEY.o))
        person.type_into("Import into this scene", str(folder / "street.ply"))
        person.until(lambda: len(editor.document.scene.layers) == 2 and person.is_idle(), 100_000)
        person.click("//Layers/members/###layers street")
        person.ctx.window_focus("//View")
        person.press(KEY.r)
        person.press(KEY.f)
        person.press(KEY.t)
        person.frames(3)
        middle_m = pivot(editor.document.scene, "layers/street", 0.0)
        middle = person.on_screen(middle_m)
        up = person.on_screen(middle_m + [0, 0, 5.0]) - middle
        handle = middle + 40 * up / np.linalg.norm(up)
        person.stroke(handle, *(handle - [0, step] for step in (5, 15, 25)))
        move = editor.document.scene.member("layers/street").to_scene
        person.say("placed", float(np.linalg.norm(move[:3, 3])), editor.document.history.undo_label)
        person.press(KEY.escape)

        person.click("//Rain/8.5")
        person.ctx.window_focus("//View")
        person.press(KEY.r)
        for time_s, turn in ((0.0, 0), (1.5, 30), (3.0, 60), (5.0, 90)):
            person.ctx.item_input_value("//Timeline/**/##time", time_s)
            person.stroke(person.at(0.5, 0.4), person.at(0.5, 0.4) + [turn, 0.2 * turn], button=1)
            person.press(KEY.k)
        path = editor.document.scene.path
        person.say("keys", path.times_s.tolist())
        (left, top), (_, height) = person.area("//Timeline/ruler")
        moments = (left + editor.playback.timeline.ruler.x(each) for each in (5.0, 3.5, 2.0))
        person.stroke(*((x, top + height / 2 - 4) for x in moments))
        person.say("scrubbed", editor.playback.clock.time_s)

        person.ctx.window_focus("//Record")
        for field, value in (("##size_px/$$0", 192), ("##size_px/$$1", 128), ("##fps", 10.0)):
            person.ctx.item_input_value(f"//Record/{field}", value)
            person.frames()
        person.click("//Record/Record...")
        person.type_into("Record timeline", str(folder / "window.mp4"))
        person.until(lambda: bool(editor.jobs.all), 1000)
        person.until_worked(person.is_idle)
        person.say("recorded", editor.jobs.all[-1].state, editor.jobs.all[-1].error)

        person.ctx.window_focus("//View")
        person.press(chord(CTRL, KEY.s))
        person.type_into("Save the scene", str(folder / "project"))
        person.until(lambda: (folder / "project" / "scene.json").exists() and person.is_idle(), 100_000)
        person.say("saved", editor.files.has_changes)
        person.ctx.window_focus("//Display")
        person.ctx.item_input_value("//Display/##autosave_s", 5.0)
        person.click("//Rain/12")
        changed = time.monotonic()
        kept = folder / ".project.autosave" / "scene" / "scene.json"
        person.until(lambda: time.monotonic() > changed + 30 or kept.exists(), 10**6)
        person.say("autosaved", time.monotonic() - changed)
        person.say("kill me")
        person.until(lambda: False, 10**9)

    person.run(script)


def second(folder):
    """Come back, recover, look."""
    editor = begin_editor(str(folder / "project"), None)
    person = Person(folder, editor)

    def script():
        editor.playback.clock.playing = False
        person.until(lambda: editor.status.question is not None, 100_000)
        person.say("asked", editor.status.question.title)
        person.ctx.item_click(f"//{editor.status.question.title}/Recover")
        person.until(lambda: person.is_idle() and editor.document.rain.intensity_mm_h == 12, 100_000)
        scene = editor.document.scene
        person.say("recovered", editor.document.rain.intensity_mm_h, scene.gaussian_count, len(scene.path.times_s))

    person.run(script)


if __name__ == "__main__":
    use_kernel_cache()
    folder = Path(sys.argv[2])
    if sys.argv[1] == "first":
        first(folder, Path(sys.argv[3]))
    else:
        second(folder)
    os._exit(0)
