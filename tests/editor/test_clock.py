"""Time that repeats, stops, is set and is stepped."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.editor.timeline import PlaybackClock


def test_without_a_span_time_goes_on_and_on():
    clock = PlaybackClock(speed=2.0)
    clock.advance(100.0)
    assert clock.time_s == 200


def test_at_the_end_of_its_span_time_begins_again_or_stops():
    clock = PlaybackClock(4.5)
    clock.advance(1.0, (1.0, 5.0))
    assert clock.time_s == pytest.approx(1.5)
    clock.loop, clock.time_s = False, 4.5
    clock.advance(1.0, (1.0, 5.0))
    assert (clock.time_s, clock.playing) == (5.0, False)
    clock.toggle()
    clock.advance(0.25, (1.0, 5.0))
    assert (clock.time_s, clock.playing) == (1.25, True)


def test_a_time_set_beyond_the_span_plays_from_its_start():
    clock = PlaybackClock(9.0)
    clock.advance(0.25, (1.0, 5.0))
    assert clock.time_s == 1.0


def test_a_stopped_clock_stands_wherever_it_is():
    clock = PlaybackClock(9.0, playing=False)
    clock.advance(1.0, (0.0, 5.0))
    assert clock.time_s == 9


@given(st.floats(0, 50), st.floats(0, 60), st.floats(0, 5), st.floats(0.01, 20))
def test_playing_time_never_leaves_its_span_at_the_end(time_s, real_s, start, length):
    clock = PlaybackClock(time_s)
    clock.advance(real_s, (start, start + length))
    assert clock.time_s <= start + length


@given(st.integers(0, 3000), st.sampled_from([24.0, 25.0, 30.0, 60.0]))
def test_steps_go_from_frame_to_frame_and_back(frame, fps):
    clock = PlaybackClock(frame / fps)
    clock.step(1, fps)
    assert clock.time_s == pytest.approx((frame + 1) / fps)
    clock.step(-1, fps)
    assert clock.time_s == pytest.approx(frame / fps)
    assert not clock.playing


def test_between_two_frames_a_step_goes_to_the_next_on_its_side_and_not_before_0():
    clock = PlaybackClock(1.05)
    clock.step(1, 10.0)
    assert clock.time_s == pytest.approx(1.1)
    clock.seek(1.05)
    clock.step(-1, 10.0)
    assert clock.time_s == pytest.approx(1.0)
    clock.seek(-3)
    assert clock.time_s == 0
    clock.step(-1, 10.0)
    assert clock.time_s == 0
