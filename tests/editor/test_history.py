from gsrain_engine.editor.document import Document, History
from gsrain_engine.rain.settings import RainSettings
from small_scene import small_scene

SCENE = small_scene()


def document(intensity):
    return Document(SCENE, RainSettings(intensity_mm_h=float(intensity)))


def history():
    return History(document(0))


def test_undo_and_redo_walk_over_the_steps():
    steps = history()
    one, two = document(1), document(2)
    steps.record("one", one)
    steps.record("two", two)
    assert (steps.undo_label, steps.redo_label) == ("two", None)
    assert steps.go_to(steps.cursor - 1) is one
    assert (steps.undo_label, steps.redo_label) == ("one", "two")
    assert steps.go_to(steps.cursor + 1) is two
    assert steps.go_to(steps.cursor + 1) is two


def test_nothing_is_before_the_beginning():
    steps = history()
    assert steps.undo_label is None
    assert steps.go_to(steps.cursor - 1) is steps.present


def test_a_new_step_forgets_what_could_be_redone():
    steps = history()
    steps.record("one", document(1))
    steps.go_to(steps.cursor - 1)
    steps.record("other", document(3))
    assert steps.redo_label is None
    assert steps.present.rain.intensity_mm_h == 3


def test_a_drag_is_one_step_and_the_next_drag_another():
    steps = history()
    for value in (1, 2, 3):
        steps.record("Intensity", document(value), "intensity")
    steps.end_gesture()
    for value in (4, 5):
        steps.record("Intensity", document(value), "intensity")
    steps.end_gesture()
    assert steps.present.rain.intensity_mm_h == 5
    assert steps.go_to(steps.cursor - 1).rain.intensity_mm_h == 3
    assert steps.go_to(steps.cursor - 1).rain.intensity_mm_h == 0


def test_another_gesture_begins_its_own_step():
    steps = history()
    steps.record("Intensity", document(1), "intensity")
    steps.record("Wind", document(2), "wind")
    assert steps.go_to(steps.cursor - 1).rain.intensity_mm_h == 1
