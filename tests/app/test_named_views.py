"""Named views on the command line: `gsrain render --view`, and the list of `gsrain info`."""

import json
from dataclasses import replace

import numpy as np
import pytest

from app.main import BAD_INPUT, run
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.named_view import NamedView
from small_scene import small_scene

SIZE = ("--size", "96x64", "--backend", "cpu")
EYE, TARGET, UP = np.array([[2.0, 1.0, 2.0], [20.0, 0.0, 1.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A scene whose unit is 50 cm, with rain, and with a view in more rain, and one without time and rain."""
    units = look_at(EYE / 0.5, TARGET / 0.5, UP)
    gate = NamedView.of("Gate", Camera.from_fov(96, 64, 40.0, units), time_s=1.5, rain={"intensity_mm_h": 30.0})
    bare = NamedView.of("Bare wall", Camera.from_fov(96, 64, 40.0, units))
    folder = tmp_path_factory.mktemp("views") / "scene"
    rainy = replace(small_scene(), metres_per_unit=0.5, views=(gate, bare), rain={"intensity_mm_h": 4.0})
    write_scene(rainy, folder)
    return folder


def rendered(scene, folder, *options):
    numbers = folder / "numbers.json"
    arguments = ["render", str(scene), "-o", str(folder / "a.npy"), *SIZE, "--json", str(numbers), *map(str, options)]
    assert run(arguments) == 0
    return np.load(folder / "a.npy"), json.loads(numbers.read_text())


def camera_file(folder):
    camera = Camera.from_fov(96, 64, 40.0, look_at(EYE / 0.5, TARGET / 0.5, UP))
    fields = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    file = folder / "camera.json"
    file.write_text(json.dumps(fields | {"world_to_camera": camera.world_to_camera.tolist()}))
    return file


def test_a_view_gives_camera_time_and_rain(scene, tmp_path):
    """The picture is that of the same camera, time and rain by other options, which have the last word."""
    camera = camera_file(tmp_path)
    gate, numbers = rendered(scene, tmp_path, "--view", "Gate")
    assert numbers["intensity_mm_h"] == 30.0
    np.testing.assert_allclose(
        gate, rendered(scene, tmp_path, "--camera", camera, "--time", 1.5, "--rain", 30)[0], atol=1e-6
    )
    other, numbers = rendered(scene, tmp_path, "--view", "Gate", "--time", 0, "--rain", 2)
    assert numbers["intensity_mm_h"] == 2.0
    np.testing.assert_allclose(other, rendered(scene, tmp_path, "--camera", camera, "--rain", 2)[0], atol=1e-6)
    assert np.abs(gate - other).max() > 0.05
    bare, numbers = rendered(scene, tmp_path, "--view", "Bare wall")
    assert numbers["intensity_mm_h"] == 4.0
    np.testing.assert_allclose(bare, rendered(scene, tmp_path, "--camera", camera)[0], atol=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--view", "gat"), "--view 'gat': scene 'small' has no view of this name; did you mean 'Gate'?"),
        (("--view", "x"), "it has 'Gate', 'Bare wall'"),
        (("--view", "Gate", "--camera", "0,0,1,5,0,1"), "--view and --camera exclude each other"),
        (("--view", "Gate", "--camera-path", "path.json"), "--view and --camera-path exclude each other"),
        (("--view", "Gate", "--cameras", "front"), "--view has no effect: the views are those of --cameras"),
        (("--view", "Gate", "--frame", "3"), "--frame 3: a still from --view has no other frame"),
    ],
)
def test_views_that_can_not_be_are_refused_in_one_line(options, words, scene, tmp_path, capsys):
    assert run(["render", str(scene), "-o", str(tmp_path / "a.png"), "--no-wet", *SIZE[2:], *options]) == BAD_INPUT
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1 and not (tmp_path / "a.png").exists()


def test_a_scene_without_views_or_with_damaged_rain_in_one_is_refused(scene, tmp_path, capsys):
    write_scene(small_scene(), tmp_path / "bare")
    assert run(["render", str(tmp_path / "bare"), "-o", str(tmp_path / "a.png"), "--view", "Gate"]) == BAD_INPUT
    assert "--view 'Gate': scene 'small' has no named views" in capsys.readouterr().err
    view = NamedView(name="Gate", position=(0, 0, 2), quaternion_wxyz=(1, 0, 0, 0), rain={"intensity_mm_h": -1.0})
    write_scene(replace(small_scene(), views=(view,)), tmp_path / "damaged")
    assert run(["render", str(tmp_path / "damaged"), "-o", str(tmp_path / "a.png"), "--view", "Gate"]) == BAD_INPUT
    error = capsys.readouterr().err
    assert "--view 'Gate': its rain can't be used" in error and "intensity_mm_h" in error and error.count("\n") == 1


def test_info_lists_the_views(scene, tmp_path, capsys):
    assert run(["info", str(scene), "--json", str(tmp_path / "info.json")]) == 0
    assert "views: Gate (1.5 s, 30 mm/h), Bare wall\n" in capsys.readouterr().out
    assert json.loads((tmp_path / "info.json").read_text())["named_views"] == [
        {"name": "Gate", "time_s": 1.5, "intensity_mm_h": 30.0},
        {"name": "Bare wall", "time_s": None, "intensity_mm_h": None},
    ]


@pytest.mark.parametrize(
    ("options", "opening", "intensity"),
    [
        ((), 0, 30.0),  # the first view
        (("--view", "Bare wall"), 1, 4.0),
        (("--view", "Gate", "--rain", "12"), 0, 12.0),
        (("--camera", "0,0,2,9,0,1"), None, 4.0),
    ],
)
def test_a_page_opens_at_a_view(options, opening, intensity, scene, tmp_path):
    page = tmp_path / "page.html"
    assert run(["publish", str(scene), "-o", str(page), "--no-wet", "--duration", "0.1", *options]) == 0
    settings = json.loads(page.read_text().split('id="settings">')[1].split("</script>")[0])
    assert settings["view"] == opening and [view["name"] for view in settings["views"]] == ["Gate", "Bare wall"]
    assert settings["states"][settings["chosen"]]["intensity"] == intensity


def test_a_page_has_one_choice_of_the_camera(scene, tmp_path, capsys):
    options = ("--view", "Gate", "--camera", "0,0,2,9,0,1")
    assert run(["publish", str(scene), "-o", str(tmp_path / "page.html"), *options]) == BAD_INPUT
    assert capsys.readouterr().err == "gsrain: --view and --camera exclude each other\n"
