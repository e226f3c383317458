"""Factors of rain: which a rain has, the rain of each coalition, and choices that make no sense."""

import numpy as np
import pytest
from msgspec import structs

from gsrain_engine.evaluation.attribution.factors import (
    ALL,
    LIGHT,
    NO_FACTORS,
    WET,
    Factor,
    RainFactors,
    clear_rain,
    factors,
    is_attributed,
    on_wet_ground,
)
from gsrain_engine.evaluation.attribution.shapley import MAX_FACTORS
from gsrain_engine.rain.frame import RainCamera, SkyLight
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.rain.wetness import wetness
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from small_scene import small_scene

RAIN = RainSettings(intensity_mm_h=12.0, mirror=True, glass="lens", visibility_m=2000.0, spray=False)


@pytest.mark.street
def test_a_rain_has_the_factors_that_act_in_it():
    for rain, scene, expected in (
        (RAIN, "street", ("streaks", "medium", "light", "wet", "mirror", "splashes", "glass")),
        (RAIN, "my_scene", ("streaks", "medium", "wet", "mirror", "splashes", "glass")),  # has no light without water
        (RainSettings(intensity_mm_h=12.0), None, ("streaks", "medium", "light", "wet", "mirror", "splashes", "spray")),
        (RainSettings(intensity_mm_h=0.2, mirror=True), "street", ("streaks", "medium")),  # dries where it falls
        (
            RainSettings(intensity_mm_h=12.0, wetness=0.5, spray=False),
            "street",
            ("streaks", "medium", "wet", "mirror", "splashes"),
        ),
        (RainSettings(intensity_mm_h=12.0, wetness=0.0, mirror=True), "street", ("streaks", "medium")),
        (RainSettings(intensity_mm_h=12.0, streaks=False, haze="none", wetness=0.0), "street", ()),
        (structs.replace(load_preset("paper"), wetness=0.0), "street", ("streaks", "medium")),
    ):
        found = RainFactors.of(rain, (ALL,), scene)
        assert found.names == expected and found.rain == rain
    assert RainFactors.of(RAIN, (ALL,), "s", lacking=("mirror",)).names == (
        "streaks", "medium", "wet", "splashes", "glass",
    )  # fmt: skip


@pytest.mark.street
def test_coalitions_of_the_same_effect_are_evaluated_once():
    found = RainFactors.of(RAIN, ("streaks", "light", "wet", "mirror"), "street")
    assert len(found.coalitions) == 16 and set(found.coalitions.values()) == set(found.evaluated)
    assert [sorted(each) for each in found.evaluated] == [
        [], ["streaks"], ["light"], ["light", "streaks"], ["light", "wet"], ["light", "streaks", "wet"],
        ["light", "mirror", "wet"], ["light", "mirror", "streaks", "wet"],
    ]  # fmt: skip
    for present, same in (
        ({"mirror"}, set()), ({"light", "mirror"}, {"light"}), ({"wet"}, {"light", "wet"}),
        ({"wet", "mirror", "streaks"}, {"light", "wet", "mirror", "streaks"}),
    ):  # fmt: skip
        assert found.coalitions[frozenset(present)] == same
    every = RainFactors.of(structs.replace(RAIN, spray=True), (ALL,), "street", friction="wet")
    assert (len(every.names), len(every.coalitions), len(every.evaluated)) == (9, 512, 160)


def test_a_list_of_factors_makes_the_rain():
    found = RainFactors.of(RainSettings(intensity_mm_h=12.0, streaks=False), ("glass", "streaks"), "street")
    assert found.names == ("streaks", "glass")
    dry = {"wetness": 0.0, "mirror": False, "splashes": False, "spray": False}
    assert found.rain == RainSettings(intensity_mm_h=12.0, glass="windshield", haze="none", **dry)


def test_coalitions_switch_the_rest_off():
    found = RainFactors.of(RAIN, (ALL,), "street")
    assert found.weather(frozenset(found.names)) == (RAIN, False, None, frozenset())
    rain, in_twin, _, _ = found.weather(frozenset({"medium", "light"}))
    assert in_twin and rain == structs.replace(
        RAIN, streak_gain=0.0, wetness=0.0, mirror=False, splashes=False, glass="none"
    )
    rain, in_twin, _, _ = found.weather(frozenset({"light", "wet", "streaks"}))
    assert not in_twin and rain.wetness is None and (rain.haze, rain.visibility_m) == ("none", None)
    none = found.weather(frozenset()).rain
    assert none == clear_rain(RAIN) and (none.intensity_mm_h, none.glass, none.visibility_m) == (0.0, "none", None)
    assert wetness(none.intensity_mm_h) == 0


def test_friction_is_a_factor_of_drives_alone():
    wet, dry = (RainFactors.of(RAIN, (ALL,), "my_scene", friction=each) for each in ("wet", "dry"))
    assert wet.names == (*dry.names, "friction")
    assert [wet.weather(frozenset(each)).friction for each in (["friction"], ["glass"], [])] == ["wet", "dry", "wet"]
    assert {dry.weather(frozenset(each)).friction for each in (["glass"], [])} == {"dry"}
    named = RainFactors.of(RAIN, ("friction", "glass"), "my_scene", friction="dry")
    assert (named.names, named.friction) == (("glass", "friction"), "wet")
    assert RainFactors.of(RAIN, ("glass",), "my_scene", friction="wet").friction == "dry"
    with pytest.raises(ValueError, match="attribute friction: pictures have none"):
        RainFactors.of(RAIN, ("friction",), "my_scene")


def test_streaks_and_medium_are_all_that_falls_and_neither_replaces_the_other():
    scene, renderer = small_scene(), CpuRenderer()
    camera = Camera.from_fov(96, 64, 60.0, look_at(np.array([0.0, 0.0, 1.5]), np.array([5.0, 0, 1.5]), np.eye(3)[2]))
    found = RainFactors.of(
        RainSettings(intensity_mm_h=100.0, exposure_s=0.02, streak_gain=20.0), ("streaks", "medium"), "s"
    )

    def drawn(rain):
        simulation = RainSimulation.start(rain)
        draw(renderer, FrameInput.of(scene, simulation, SkyLight.uniform((0.9, 0.9, 0.9)), RenderView(camera)))
        medium = simulation.frame(0.0, RainCamera(camera, np.eye(4), np.zeros(3))).medium
        return renderer.read().rgba[..., :3].copy(), medium

    coalitions = [(), ("streaks",), ("medium",), ("streaks", "medium")]
    (none, _), (streaks, nothing), (medium, own), (_, same) = (
        drawn(found.weather(frozenset(each)).rain) for each in coalitions
    )
    assert nothing is None and own.drawn.max() > 0
    np.testing.assert_array_equal(own.drawn, same.drawn)
    assert abs(streaks - none).max() > 0.01 < abs(medium - none).max()
    hidden, _ = drawn(structs.replace(found.rain, streak_gain=0.0, haze="none"))
    np.testing.assert_array_equal(hidden, none)


def test_choices_that_make_no_sense():
    assert not is_attributed(()) and not is_attributed((NO_FACTORS,)) and is_attributed((ALL,))
    for names, words in (
        (("rain",), "expected all, or some of streaks, medium, light, wet, mirror, splashes, spray, glass"),
        (("streaks", "mirror"), "mirror: has a share only next to wet"),
        (("light",), "light: has a share only next to wet"),
        ((NO_FACTORS, ALL), "none: expected"),
    ):
        with pytest.raises(ValueError, match=words):
            is_attributed(names)
    with pytest.raises(ValueError, match="mirror: my_scene has none"):
        RainFactors.of(RAIN, ("wet", "mirror"), "my_scene", lacking=("mirror",))


def test_rows_name_settings_that_are_there():
    with pytest.raises(ValueError, match="rain has no setting puddles"):
        Factor("puddles", "puddles", {"puddles": False})
    names = list(factors())
    assert len(names) <= MAX_FACTORS and names.index(LIGHT) < names.index(WET) == min(
        names.index(each) for each in on_wet_ground() - {LIGHT}
    )  # so that steps add them in order
