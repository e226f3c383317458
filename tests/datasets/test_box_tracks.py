import numpy as np
import pytest

from gsrain_engine.datasets.geometry import BoxSample, tracked_boxes

TIMES = [0.0, 1.0, 2.0, 3.0, 4.0]


def _sample(time: float, x: float, name: str = "a", height: float = 2.0) -> BoxSample:
    pose = np.eye(4)
    pose[:3, 3] = x, 0.0, 5.0
    return BoxSample(name, "car", time, (4.0, 2.0, height), pose)


def _x(samples: list[BoxSample], time: float) -> float | None:
    (box,) = tracked_boxes(samples, TIMES)
    pose = box.track.pose(time)
    return None if pose is None else float(pose[0, 3])


def test_the_origin_is_the_bottom_centre() -> None:
    (box,) = tracked_boxes([_sample(time, 0.0) for time in TIMES], TIMES)
    np.testing.assert_allclose(box.track.positions[:, 2], 4.0)


def test_moves_between_samples_and_on_at_the_ends_of_the_drive() -> None:
    samples = [_sample(time, 10 * time) for time in TIMES]
    for time in (0.0, 0.25, 2.5, 4.0):
        assert _x(samples, time) == pytest.approx(10 * time)
    # A camera may fire before the first sweep and after the last one: for half a step it moves on.
    assert _x(samples, -0.4) == pytest.approx(-4.0)
    assert _x(samples, 4.4) == pytest.approx(44.0)


def test_is_there_from_half_way_to_half_way() -> None:
    samples = [_sample(1.0, 10.0), _sample(2.0, 20.0)]
    assert [_x(samples, time) for time in (-1.0, 0.0, 0.4, 2.6, 4.0, 9.0)] == [None] * 6
    assert _x(samples, 0.6) == pytest.approx(6.0)
    assert _x(samples, 2.4) == pytest.approx(24.0)


def test_goes_away_and_comes_back() -> None:
    samples = [_sample(0.0, 0.0), _sample(2.0, 20.0), _sample(4.0, 40.0)]
    assert [_x(samples, time) for time in (0.4, 0.6, 1.4, 1.6, 2.4, 2.6, 3.4, 3.6)] == [
        0,
        None,
        None,
        20,
        20,
        None,
        None,
        40,
    ]


def test_a_single_sample_of_a_single_time() -> None:
    (box,) = tracked_boxes([_sample(7.0, 1.0)], [7.0])
    pose = box.track.pose(7.3)
    assert pose is not None
    assert len(box.track.times) == 1


def test_the_size_is_the_median() -> None:
    (box,) = tracked_boxes([_sample(k, 0.0, height=h) for k, h in enumerate((2.0, 2.1, 9.0))], TIMES)
    assert box.size_lwh == (4.0, 2.0, 2.1)


@pytest.mark.parametrize(
    "size", [(0.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, np.nan), (1.0, np.inf, 1.0), (1e9, 1.0, 1.0)]
)
def test_refuses_sizes_that_no_thing_has(size: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="expected 0 to 1000 m"):
        BoxSample("a", "car", 0.0, size, np.eye(4))
