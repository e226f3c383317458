"""Lamps that a picture has: of files, of vehicles, none, and the scene's own."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.scene.lamp_choice import LampChoice, lamp_choice, load_lamps
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.scene import Actor, PoseTrack, Scene
from gsrain_engine.scene.vehicle_lamps import VehicleLamps
from render.test_backends_agree import raining, small_shot
from small_scene import small_scene

OWN = (Lamp(name="post", position=(0.0, 0.0, 6.0)), Lamp(name="old", position=(0.0, 0.0, 0.5), mount="ego"))
FILE = """
- {name: post, position: [1, 2, 6], color: [1, 0.7, 0.4], intensity_m2: 50, inner_deg: 30, outer_deg: 70}
- mount: vehicles
  headlight_m2: 100
"""


def on_road(x: float, y: float = 0.0, turned: float = 0.0) -> PoseTrack:
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]]
    pose[:2, 3] = x, y
    return PoseTrack.standing(pose)


def traffic(metres_per_unit: float = 1.0) -> Scene:
    """A car that is 20 m ahead and comes toward the ego vehicle, and a pedestrian."""
    unit = 1 / metres_per_unit
    gaussians = small_scene().layers[0].gaussians
    car = Actor("car 1", "Car", (4 * unit, 2 * unit, 1.5 * unit), gaussians, on_road(20 * unit, 3 * unit, np.pi))
    walker = Actor("walker", "Pedestrian", (unit, unit, 2 * unit), gaussians, on_road(10 * unit))
    rig = PoseTrack(np.zeros(1), np.array([[0.0, 0.0, 1.6 * unit]]), np.array([[1.0, 0, 0, 0]]), np.ones(1, bool))
    return Scene("", actors=(car, walker), ego=rig, ground_m=0.0, lamps=OWN, metres_per_unit=metres_per_unit)


@pytest.mark.parametrize("metres_per_unit", [1.0, 0.25])
def test_headlights_and_tail_lights_are_at_the_ends_of_vehicles(metres_per_unit) -> None:
    scene = traffic(metres_per_unit)
    lamps = VehicleLamps(mount="vehicles").of(scene)
    lit = scene.lamps_at(0.0, lamps)
    assert [lamp.mount for lamp in lamps] == ["ego"] * 4 + ["car 1"] * 4  # none on the pedestrian
    of = {lamp.name: (lit.positions_m[i], lit.directions[i]) for i, lamp in enumerate(lamps)}
    np.testing.assert_allclose(of["ego left headlight"][0], [3.6, 0.703, 0.675], atol=1e-6)
    np.testing.assert_allclose(of["ego right tail light"][0], [-1.0, -0.703, 0.9], atol=1e-6)
    np.testing.assert_allclose(of["car 1 left headlight"][0], [18.0, 3 - 0.76, 0.675], atol=1e-6)
    assert of["car 1 left headlight"][1][0] < -0.99 < 0.99 < of["car 1 left tail light"][1][0]


def test_narrow_vehicles_have_one_headlight() -> None:
    scene = traffic()
    actor = replace(scene.actors[0], size_lwh=(3.0, 1.0, 1.5))
    lamps = VehicleLamps(mount="vehicles").of(replace(scene, ego=None, actors=(actor,)))
    assert [lamp.name for lamp in lamps] == ["car 1 headlight", "car 1 tail light"]
    assert all(lamp.position[1] == 0 for lamp in lamps)


def test_choices_replace_the_lamps_of_a_scene(tmp_path) -> None:
    (tmp_path / "lamps.yaml").write_text(FILE)
    scene = traffic()
    assert LampChoice().of(scene) == OWN
    assert lamp_choice("none").of(scene) == ()
    assert [lamp.name for lamp in lamp_choice("headlights").of(scene)][:2] == ["post", "ego left headlight"]
    listed = lamp_choice(str(tmp_path / "lamps.yaml")).of(scene)
    assert (listed[0].name, listed[0].intensity_m2, listed[0].outer_deg) == ("post", 50.0, 70.0)
    assert [lamp.intensity_m2 for lamp in listed[1:5]] == [100.0, 1.0, 100.0, 1.0]
    (tmp_path / "lamps.json").write_text('[{"position": [0, 0, 1]}]')
    assert load_lamps(tmp_path / "lamps.json") == (Lamp(position=(0.0, 0.0, 1.0)),)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("- {position: [0, 0, 1]}\n- {color: [1, 1, 1]}", "lamp 2: Object missing required field `position`"),
        ("- {position: [0, 0, 1], colour: [1, 1, 1]}", "lamp 1: .*did you mean `color`"),
        ("- {position: [0, 0, 1], intensity_m2: -3}", r"lamp 1: -3 must be at least 0 - at `\$.intensity_m2`"),
        ("- {mount: vehicles, position: [0, 0, 1]}", "lamp 1: .*unknown field `position`; valid: mount, headlight_m2"),
        ("lamps: []", "expected a list of lamps"),
        ("- {position: [0, .nan, 1]}", "finite number"),
        ("[", "not readable as YAML"),
    ],
)
def test_a_wrong_file_gets_one_sentence(tmp_path, text, sentence) -> None:
    (tmp_path / "lamps.yaml").write_text(text)
    with pytest.raises(ValueError, match=rf"lamps\.yaml: .*{sentence}") as raised:
        lamp_choice(str(tmp_path / "lamps.yaml"))
    assert "\n" not in str(raised.value)


def test_a_missing_file_is_reported_with_the_words() -> None:
    with pytest.raises(ValueError, match=r"lamps missing\.yaml: no such file, and none of none, auto, headlights"):
        RainSimulation.start(RainSettings(lamps="missing.yaml"))


def test_a_preset_names_a_file_in_its_own_folder(tmp_path) -> None:
    (tmp_path / "lamps.yaml").write_text(FILE)
    (tmp_path / "night.yaml").write_text("lamps: lamps.yaml\n")
    (tmp_path / "dark.yaml").write_text("lamps: none\n")
    (tmp_path / "none").write_text("")  # a file of that name is not meant
    simulation = RainSimulation.start(load_preset(str(tmp_path / "night.yaml")))
    assert len(simulation.lamps.listed) == 2
    assert simulation.changed(RainSettings(lamps="none"), 1.0).lamps == LampChoice("none")
    assert load_preset(str(tmp_path / "dark.yaml")).lamps == "none"


def test_pictures_have_the_chosen_lamps(tmp_path) -> None:
    """A file of a scene's own lamps makes the picture that they make; `none` that of a scene without lamps."""
    lamp = Lamp(position=(12.0, 2.0, 4.0), intensity_m2=20.0)
    (tmp_path / "lamps.yaml").write_text("- {position: [12, 2, 4], intensity_m2: 20}")
    dark, shot = small_scene(), small_shot(48, 30)
    images = {}
    for name, scene, choice in (
        ("own", replace(dark, lamps=(lamp,)), None), ("file", dark, str(tmp_path / "lamps.yaml")),
        ("none", replace(dark, lamps=(lamp,)), "none"), ("dark", dark, None),
    ):  # fmt: skip
        renderer = CpuRenderer()
        draw(
            renderer,
            FrameInput.of(
                scene, RainSimulation.start(raining(lamps=choice)), SkyLight.uniform((0.05, 0.05, 0.06)), shot
            ),
        )
        images[name] = renderer.read_uint8().copy()
    assert np.array_equal(images["own"], images["file"]) and np.array_equal(images["none"], images["dark"])
    assert not np.array_equal(images["own"], images["dark"])
