"""Commands of the Rain menu, without a window."""

import pytest

pytest.importorskip("imgui_bundle")

from gsrain_engine.editor.editor import Editor
from gsrain_engine.rain.keyframes import shower_keyframes
from small_scene import small_scene
from ui.commands.registry import ACTIONS
from ui.tools import TOOLS


@pytest.fixture
def session():
    session = Editor(small_scene())
    session.clock.playing = False
    yield session
    session.close()


def do(session, name):
    (action,) = [each for each in ACTIONS if each.name == name]
    assert action.help and action.menu == "Rain"
    assert action.is_possible(session)
    action.run(session)
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
def test_intensities(session, name, rate):
    session.change_rain("Some", intensity_mm_h=3.0)
    action = do(session, name)
    assert session.rain.intensity_mm_h == rate
    assert action.is_on(session)
    session.undo()
    assert session.rain.intensity_mm_h == 3.0


@pytest.mark.parametrize(("name", "field"), [("Draw streaks", "streaks"), ("Draw haze", "haze")])
def test_switches(session, name, field):
    action = do(session, name)
    assert not getattr(session.rain, field) and not action.is_on(session)
    do(session, name)
    assert getattr(session.rain, field) and action.is_on(session)


def test_regions_and_tools(session):
    action = do(session, "Show rain regions")
    assert session.view.show_streak_region and session.view.show_haze_region and action.is_on(session)
    do(session, "Show rain regions")
    assert not session.view.show_streak_region and not session.view.show_haze_region
    for name in ("Edit rain regions", "Pick the drop color"):
        action = do(session, name)
        assert session.view.tool in [tool.name for tool in TOOLS] and action.is_on(session)
        do(session, name)
        assert session.view.tool == ""


def test_keys_and_shower(session):
    session.clock.time_s = 3.0
    do(session, "Add passing shower")
    assert session.weather == shower_keyframes(3.0)
    session.clock.time_s = 8.0
    for name, field in (("intensity", "intensity_mm_h"), ("wind", "wind_m_s"), ("exposure", "exposure_s")):
        do(session, f"Insert {name} keyframe")
        assert 8.0 in session.weather.key_times[field].tolist()
    do(session, "Add passing shower")
    assert session.weather.key_times["wind_m_s"].tolist() == [8.0]  # only the intensity's keys give way
    assert session.weather.key_at(38.0).intensity_mm_h == 12.0
    do(session, "Clear rain keyframes")
    assert session.weather.keys == ()


def test_the_drop_color_goes_back_to_the_sky(session):
    (action,) = [each for each in ACTIONS if each.name == "Reset the drop color to the sky"]
    assert not action.is_possible(session)
    session.change_rain("Color", drop_color=(1.0, 0.0, 0.0))
    do(session, action.name)
    assert session.rain.drop_color is None
