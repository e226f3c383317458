"""Settings and schedule of a training."""

from typing import get_type_hints

import msgspec
import numpy as np
import pytest

from gsrain_engine.datasets.capture import CaptureFrame
from gsrain_engine.scene.camera import Camera
from gsrain_engine.training.settings import (
    TrainingSchedule,
    TrainingSettings,
    camera_extent,
    load_settings,
    settings_names,
    view_order,
)


def test_the_means_slow_down_exponentially_from_the_papers_first_rate_to_its_last():
    schedule = TrainingSchedule(TrainingSettings(steps=101, haste=1.0), extent=3.0)
    means = [schedule.rates(step)["means"] for step in (0, 50, 100)]
    assert means == pytest.approx([1.6e-4 * 3, 1.6e-5 * 3, 1.6e-6 * 3])
    assert schedule.rates(0)["opacity_logits"] == 5e-2
    assert schedule.rates(0)["sh_dc"] == 20 * schedule.rates(0)["sh_rest"]


def test_haste_multiplies_every_rate():
    slow, fast = (TrainingSchedule(TrainingSettings(haste=haste), 1.0).rates(7) for haste in (1.0, 3.0))
    assert fast == pytest.approx({name: 3 * rate for name, rate in slow.items()})


def test_pictures_grow_and_harmonics_join_in():
    schedule = TrainingSchedule(TrainingSettings(steps=100, coarse=0.4, sh_degree=3), 1.0)
    assert [schedule.level(step) for step in (0, 19, 20, 39, 40, 99)] == [2, 2, 1, 1, 0, 0]
    assert [schedule.sh_degree(step) for step in (0, 19, 20, 40, 60, 99)] == [0, 0, 1, 2, 3, 3]
    assert TrainingSchedule(TrainingSettings(steps=100, coarse=0.0), 1.0).level(0) == 0
    assert TrainingSchedule(TrainingSettings(steps=100, sh_degree=1), 1.0).sh_degree(99) == 1


def test_every_view_comes_once_an_epoch_in_changing_order():
    order = view_order(7, 30, seed=5)
    assert len(order) == 30
    epochs = [order[k : k + 7] for k in range(0, 28, 7)]
    assert all(sorted(epoch) == list(range(7)) for epoch in epochs)
    assert len({tuple(epoch) for epoch in epochs}) > 1
    assert order == view_order(7, 30, seed=5) != view_order(7, 30, seed=6)
    assert view_order(7, 10, seed=5) == order[:10]


def test_the_extent_is_that_of_the_cameras():
    views = []
    for x in (0.0, 20.0):
        pose = np.eye(4)
        pose[0, 3] = -x
        views.append(CaptureFrame(str(x), Camera(8, 8, 8, 8, 4, 4, pose), np.zeros((8, 8, 3), np.uint8)))
    assert camera_extent(views) == pytest.approx(11)
    assert camera_extent(views[:1]) == 1


@pytest.mark.parametrize("name", ["draft", "full", "laptop"])
def test_shipped_settings_are_valid(name):
    assert name in settings_names()
    assert load_settings(name).steps > 0


def test_the_defaults_are_the_laptop_ones():
    assert load_settings("laptop") == TrainingSettings()


def test_changes_go_on_top_of_a_file_and_none_changes_nothing(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("steps: 77\nrates: {means: 0.001}\n")
    settings = load_settings(file, width_px=99, seed=None)
    assert (settings.steps, settings.width_px, settings.seed, settings.rates.means) == (77, 99, 0, 0.001)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("stps: 5\n", "unknown field `stps`"),
        ("d_ssim: 2\n", r"Expected `float` <= 1\.0 - at `\$\.d_ssim`"),
        ("- 5\n", "expected a YAML mapping"),
        ("steps: [\n", "mine.yaml"),
    ],
)
def test_a_bad_file_is_named_with_its_field(tmp_path, text, said):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(ValueError, match=said) as caught:
        load_settings(file)
    assert "mine.yaml" in str(caught.value)


def test_bad_changes_are_refused_by_field():
    with pytest.raises(msgspec.ValidationError, match=r"\$\.steps"):
        load_settings(None, steps=0)


def test_every_setting_has_its_help():
    for name in TrainingSettings.__struct_fields__:
        if name != "rates":
            meta = get_type_hints(TrainingSettings, include_extras=True)[name].__metadata__[-1]
            assert len(meta.description) > 15
