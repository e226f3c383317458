"""Arguments and array shapes are checked while tests run."""

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from gsrain_engine.scene.camera import look_at
from type_checker import CHECKED_CALLS

EYE, TARGET, UP = np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("earlier", [0, 10 * CHECKED_CALLS, 0])
def test_a_wrong_shape_is_an_error_in_each_test_anew(earlier):
    with pytest.raises(TypeCheckError):
        look_at(EYE, TARGET, np.zeros(2))
    for _ in range(earlier):
        look_at(EYE, TARGET, UP)
