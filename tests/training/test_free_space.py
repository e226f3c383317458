"""The room that cameras look through stays empty, whatever a training puts there."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gsrain_engine.training.free_space import (  # noqa: E402
    FreeSpaceCarving,
    clear_free_space,
    clip_long_gaussians,
    prune_free_space,
)
from gsrain_engine.training.parameters import SplatParameters  # noqa: E402
from gsrain_engine.training.surfels import (  # noqa: E402
    LONGEST,
    camera_trajectory,
)

from .drive_capture import drive_capture, world_depth  # noqa: E402
from .random_splats import random_splats  # noqa: E402


def free(share: float = 0.4, measured: bool = True) -> FreeSpaceCarving | None:
    views = drive_capture(3).views
    depths = [np.where(np.isfinite(d := world_depth(v.camera)), d, 0).astype(np.float32) for v in views]
    if not measured:
        depths = [np.zeros_like(depth) for depth in depths]
    return FreeSpaceCarving.of([view.camera for view in views], depths, camera_trajectory(views, 20.0), share)


def splats(means: list[list[float]]) -> SplatParameters:
    found = SplatParameters.from_gaussians(random_splats(len(means), 1), 1)
    found.put("means", slice(None), torch.tensor(means))
    return found


# The cameras stand at x = 0, 1, 2 and see a wall at x = 30, over a road at z = -1.5; above it there is sky.


def test_what_stands_before_a_wall_is_in_the_way_and_the_wall_is_not() -> None:
    space = free()
    assert space is not None
    points = np.array([[8, 0, 1], [29, 0, 1], [12, 0.5, 0.3], [-3, 0, 0], [8, 0, 6]], np.float32)
    assert space.holds(points).tolist() == [True, False, True, False, False]


def test_a_smaller_share_frees_less() -> None:
    near, far = free(0.2), free(0.4)
    assert near is not None and far is not None
    points = np.array([[10, 0, 1]], np.float32)
    assert not near.holds(points)[0] and far.holds(points)[0]


def test_nothing_is_near_the_way_of_the_cameras() -> None:
    space = free(0.0)
    assert space is not None and 0.1 < space.near < 1.5
    between, beside = [0.5, 0.0, 0.0], [0.5, 0.0, -1.5]
    assert space.holds(np.array([between, beside], np.float32)).tolist() == [True, False]


def test_without_depth_nothing_is_known() -> None:
    assert free(measured=False) is None


def test_clearing_keeps_the_others_and_tells_how_many_went() -> None:
    space = free()
    assert space is not None
    found = splats([[8, 0, 1], [29, 0, 1], [12, 0.5, 0.3]])
    assert prune_free_space(found, space) == 2
    assert found.tensors["means"].tolist() == [[29, 0, 1]]
    assert prune_free_space(found, space) == 0


def test_what_is_near_the_cameras_may_not_become_long() -> None:
    space = free()
    assert space is not None
    found = splats([[1.0, 0, -1.5], [29, 0, 1]])
    found.put("log_scales", slice(None), torch.full((2, 3), np.log(2.0)))
    clip_long_gaussians(found, space)
    near, far = found.scales.detach().amax(dim=1).tolist()
    assert near < 5 * LONGEST * 1.5 and far == pytest.approx(2.0)


def test_a_control_clears_now_and_then_and_at_the_end() -> None:
    space = free()
    assert space is not None
    for step, done in ((7, None), (25, "1 cleared away"), (39, "1 cleared away")):
        found = splats([[8, 0, 1], [29, 0, 1]])
        assert clear_free_space(step, 40, found, space) == done
        assert len(found) == (2 if done is None else 1)
