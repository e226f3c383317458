"""Semantic classes of what a scene shows."""

from dataclasses import replace

import pytest

from gsrain_engine.scene.open import load_street
from gsrain_engine.simulation.sensors import UNKNOWN, semantic_ids
from simulation.small_drive import box_actor
from small_scene import small_scene


def test_every_layer_of_the_street_has_a_class():
    street = load_street()
    ids = dict(zip(("nothing", *(each.name for each in street.members)), semantic_ids(street).tolist(), strict=True))
    assert UNKNOWN not in ids.values()
    assert (ids["nothing"], ids["road"], ids["pavements"], ids["houses"], ids["trees"], ids["sky"]) == (
        10,
        0,
        1,
        2,
        8,
        10,
    )
    assert ids["lead"] == 13


@pytest.mark.parametrize(("class_name", "id"), [("car", 13), ("truck", 14), ("pedestrian", 11), ("dinosaur", UNKNOWN)])
def test_actors_have_the_class_that_they_are_called(class_name, id):
    scene = replace(small_scene(), actors=(replace(box_actor(), class_name=class_name),))
    assert semantic_ids(scene).tolist() == [10, 0, UNKNOWN, 10, id]
