"""Commands of the Rain menu, without a window."""

import pytest

pytest.importorskip("imgui_bundle")

from gsrain_engine.editor.editor import Editor
from gsrain_engine.rain.keyframes import shower_keyframes
from small_scene import small_scene
from ui.commands.registry import ACTIONS
from ui.tools import TOOLS


@pytest.fixture
def editor():
    editor = Editor(small_scene())
    editor.playback.clock.playing = False
    yield editor
    editor.close()


def do(editor, name):
    (action,) = [each for each in ACTIONS if each.name == name]
    assert action.help and action.menu == "Rain"
    assert action.is_possible(editor)
    action.run(editor)
    return action


@pytest.mark.parametrize(
    ("name", "rate"),
    [
        ("No rain", 0.0),
        ("Light 1.2 mm/h", 1.2),
        ("Moderate 5 mm/h", 5.0),
        ("Paper 8.5 mm/h", 8.5),
        ("Heavy 12 mm/h", 12.0),
    ],
)
def test_intensities(editor, name, rate):
    editor.document.change_rain("Some", intensity_mm_h=3.0)
    action = do(editor, name)
    assert editor.document.rain.intensity_mm_h == rate
    assert action.is_on(editor)
    editor.document.undo()
    assert editor.document.rain.intensity_mm_h == 3.0


@pytest.mark.parametrize(("name", "field"), [("Draw streaks", "streaks"), ("Draw haze", "haze")])
def test_switches(editor, name, field):
    action = do(editor, name)
    assert not getattr(editor.document.rain, field) and not action.is_on(editor)
    do(editor, name)
    assert getattr(editor.document.rain, field) and action.is_on(editor)


def test_regions_and_tools(editor):
    action = do(editor, "Show rain regions")
    assert (
        editor.viewport.options.show_streak_region and editor.viewport.options.show_haze_region and action.is_on(editor)
    )
    do(editor, "Show rain regions")
    assert not editor.viewport.options.show_streak_region and not editor.viewport.options.show_haze_region
    for name in ("Edit rain regions", "Pick the drop color"):
        action = do(editor, name)
        assert editor.viewport.options.tool in [tool.name for tool in TOOLS] and action.is_on(editor)
        do(editor, name)
        assert editor.viewport.options.tool == ""


def test_keys_and_shower(editor):
    editor.playback.clock.time_s = 3.0
    do(editor, "Add passing shower")
    assert editor.document.keyframes == shower_keyframes(3.0)
    editor.playback.clock.time_s = 8.0
    for name, field in (("intensity", "intensity_mm_h"), ("wind", "wind_m_s"), ("exposure", "exposure_s")):
        do(editor, f"Insert {name} keyframe")
        assert 8.0 in editor.document.keyframes.key_times[field].tolist()
    do(editor, "Add passing shower")
    assert editor.document.keyframes.key_times["wind_m_s"].tolist() == [8.0]  # only the intensity's keys give way
    assert editor.document.keyframes.key_at(38.0).intensity_mm_h == 12.0
    do(editor, "Clear rain keyframes")
    assert editor.document.keyframes.keys == ()


def test_the_drop_color_goes_back_to_the_sky(editor):
    (action,) = [each for each in ACTIONS if each.name == "Reset the drop color to the sky"]
    assert not action.is_possible(editor)
    editor.document.change_rain("Color", drop_color=(1.0, 0.0, 0.0))
    do(editor, action.name)
    assert editor.document.rain.drop_color is None
