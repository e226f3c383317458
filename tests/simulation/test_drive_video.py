"""Films of drives: figures that stay apart however narrow the film is."""

from itertools import pairwise

import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.simulation.playback import RolloutPlayback
from gsrain_engine.simulation.video import RolloutVideo, figure_slots
from simulation.small_drive import driven, lead, scene_with_box

PAPER = (18, 20, 24)


@pytest.mark.parametrize(("width", "lines"), [(960, 1), (572, 1), (480, 2), (320, 2), (160, 6), (64, 7)])
def test_figures_stand_beside_each_other_or_in_further_lines(width, lines):
    slots = figure_slots(width)
    assert len(slots) == 7 and 1 + slots[-1].line == lines
    assert all(slot.left_px < width for slot in slots)
    for before, after in pairwise(slots):
        beside = after.left_px == pytest.approx(before.left_px + before.room_px)
        assert beside if after.line == before.line else after.line == before.line + 1


def test_a_narrow_film_is_as_high_as_its_lines_and_a_long_name_ends_in_its_slot():
    asked = {"road_users": [lead(ahead_m=20.0)], "duration_s": 0.5, "picture_width_px": 320}
    played = RolloutPlayback(driven(asked, scene_with_box()), scene_with_box())
    with open_renderer("cpu") as renderer:
        video = RolloutVideo(played, renderer)
        picture = video.picture(0.0)
    slots, seen = figure_slots(320), round(320 * played.rig.cameras[0].height / played.rig.cameras[0].width)
    strip = picture[seen : seen + 2 * 23]
    inked = (strip != PAPER).any(axis=(0, 2))
    agent, time = slots[1], slots[2]
    assert not inked[: int(slots[0].left_px)].any()
    assert (strip[:23, int(agent.left_px) : int(time.left_px)] != PAPER).any()
    assert not (strip[:23, int(time.left_px) - 1] != PAPER).any()
    assert picture.shape[1] == 320 and np.ptp(strip[23:]) > 100
