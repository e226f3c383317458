"""The room that cameras look through stays empty, whatever a training puts there."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gsrain_engine.training.free_space import FreeSpaceCarving, clear_free_space, clip_long_gaussians  # noqa: E402
from gsrain_engine.training.parameters import SplatParameters  # noqa: E402
from gsrain_engine.training.surfels import LONGEST, camera_trajectory  # noqa: E402

from .drive_capture import drive_capture, world_depth  # noqa: E402
from .random_splats import random_splats  # noqa: E402


def carving(share: float = 0.4) -> FreeSpaceCarving:
    views = drive_capture(3).views
    depths = [np.where(np.isfinite(d := world_depth(v.camera)), d, 0).astype(np.float32) for v in views]
    found = FreeSpaceCarving.of([view.camera for view in views], depths, camera_trajectory(views, 20.0), share)
    assert found is not None
    return found


def splats(means: list[list[float]]) -> SplatParameters:
    found = SplatParameters.from_gaussians(random_splats(len(means), 1), 1)
    found.put("means", slice(None), torch.tensor(means))
    return found


# The cameras stand at x = 0, 1, 2 over a road at z = -1.5, with a wall at x = 30; above it there is sky.


@pytest.mark.parametrize(
    ("share", "point", "expected"),
    [
        (0.4, (8, 0, 1), True), (0.4, (12, 0.5, 0.3), True), (0.4, (10, 0, 1), True),
        (0.4, (29, 0, 1), False),  # the wall
        (0.4, (-3, 0, 0), False),  # behind the cameras
        (0.4, (8, 0, 6), False),  # before the sky
        (0.2, (10, 0, 1), False),
        (0.0, (0.5, 0, 0), True),  # on the trajectory
        (0.0, (0.5, 0, -1.5), False),
    ],
)  # fmt: skip
def test_what_lies_before_a_surface_or_on_the_trajectory_is_in_free_space(share, point, expected) -> None:
    space = carving(share)
    assert 0.1 < space.near < 1.5
    assert bool(space.holds(np.array([point], np.float32))[0]) == expected


def test_free_space_is_cleared_periodically_and_at_the_end() -> None:
    space = carving()
    for step, done in ((7, None), (25, "1 cleared away"), (39, "1 cleared away")):
        found = splats([[8, 0, 1], [29, 0, 1]])
        assert clear_free_space(step, 40, found, space) == done
        assert found.tensors["means"][-1].tolist() == [29, 0, 1] and len(found) == (2 if done is None else 1)
    assert clear_free_space(50, 60, found, space) is None


def test_gaussians_near_the_cameras_may_not_become_long() -> None:
    space = carving()
    found = splats([[1.0, 0, -1.5], [29, 0, 1]])
    found.put("log_scales", slice(None), torch.full((2, 3), np.log(2.0)))
    clip_long_gaussians(found, space)
    near, far = found.scales.detach().amax(dim=1).tolist()
    assert near < 5 * LONGEST * 1.5 and far == pytest.approx(2.0)
