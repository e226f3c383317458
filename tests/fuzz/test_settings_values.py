"""Values of every kind and size in the place of settings: each is taken as it is, or refused with its place."""

import math
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import inspect

from gsrain_engine.appearance.finetune.settings import FinetuningSettings
from gsrain_engine.editor.preferences import Preferences
from gsrain_engine.evaluation.detection.description import DetectorDescription
from gsrain_engine.evaluation.lidar.sensor import LidarSensor
from gsrain_engine.rain.calibration import Calibration
from gsrain_engine.rain.keyframes import RainKeyframes
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.safe_io.errors import convert_checked
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.sweep.settings import DriveSweep, RenderSweep
from gsrain_engine.training.settings import TrainingSettings

from .settings_readers import assert_finite

KINDS = (
    RainSettings, RainKeyframes, Calibration, Scenario, DriveSweep, RenderSweep, TrainingSettings, FinetuningSettings,
    DetectorDescription, LidarSensor, Preferences,
)  # fmt: skip
ODD = st.sampled_from(
    [math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -0.0, 0, 1, -1, 2**31, 2**63, 2**64, 10**30, True, None, "",
     "x", "1", "nan", "a" * 3000, "\x1b[31m", [], {}, [[]], [None], {"": 0}]
)  # fmt: skip


def values_of(kind: inspect.Type, depth: int = 0) -> st.SearchStrategy[Any]:
    """Plain values for a type: as it may be, at its bounds and beyond them, and now and then anything else."""
    match kind:
        case inspect.Metadata(type=inner):
            found = values_of(inner, depth)
        case inspect.FloatType(ge=ge, gt=gt, le=le, lt=lt) | inspect.IntType(ge=ge, gt=gt, le=le, lt=lt):
            found = st.floats(-100, 100) if isinstance(kind, inspect.FloatType) else st.integers(-100, 1000)
            for edge in (ge, gt, le, lt):
                if edge is not None:
                    found |= st.sampled_from([edge, math.nextafter(edge, math.inf), math.nextafter(edge, -math.inf)])
        case inspect.BoolType():
            found = st.booleans()
        case inspect.LiteralType(values=words):
            found = st.sampled_from(sorted(words, key=str))
        case inspect.NoneType():
            found = st.none()
        case inspect.UnionType(types=types):
            found = st.one_of(*(values_of(each, depth) for each in types))
        case inspect.VarTupleType(item_type=item) | inspect.ListType(item_type=item):
            found = st.lists(values_of(item, depth + 1), max_size=3)
        case inspect.TupleType(item_types=items):
            found = st.tuples(*(values_of(each, depth + 1) for each in items)).map(list)
        case inspect.StructType(fields=fields, tag_field=tag_field, tag=tag):
            needed = {} if tag_field is None else {tag_field: st.just(tag)}
            free: dict[str, Any] = {}
            for each in fields:
                (needed if each.required else free)[each.encode_name] = values_of(each.type, depth + 1)
            found = st.fixed_dictionaries(needed, optional=free if depth < 3 else {})
        case _:
            found = st.text(max_size=8)
    return st.integers(0, 60).flatmap(lambda roll: ODD if roll == 0 else found)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_values_are_taken_or_refused_with_their_place(kind: type):
    @given(values_of(inspect.type_info(kind)))
    def check(values: Any) -> None:
        try:
            made = convert_checked(values, kind)
        except ValueError as error:
            assert str(error).isprintable() and len(str(error)) <= 700
            return
        assert_finite(made)
        assert convert_checked(msgspec.json.decode(msgspec.json.encode(made)), kind) == made

    check()


def test_a_long_wrong_word_is_shortened_and_the_allowed_ones_are_named():
    with pytest.raises(ValueError, match="expected linear, smooth - at") as caught:
        convert_checked({"between": "a" * 3000}, RainKeyframes)
    assert len(str(caught.value)) <= 700
