"""Scenes by day, relit by lamps: light by the formula, shadows, default lamps, files, and a night that is refused."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

import gsrain as gr
from app.main import BAD_INPUT, run
from editor.files.open_document import settle
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import set_locked
from gsrain_engine.editor.steps import EditStep, apply_steps, steps_since
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.geometry import srgb_to_linear
from gsrain_engine.scene.lamps import LANTERN_HEIGHT_M, Lamp
from gsrain_engine.scene.open import load_scene
from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.scene.scene import Layer, PoseTrack, Scene
from gsrain_extras.night.lamp_shadows import OpacityGrid
from gsrain_extras.night.lanterns import RIGHT_M, SPACING_M
from gsrain_extras.night.night_gaussians import SurfaceNormals, light_of_lamps, night_scene
from small_scene import small_scene
from training.small_street import flat_patch
from ui.commands.table import all_commands

LAMP = Lamp(name="one", position=(5.0, 0.0, 6.0), color=(1.0, 0.5, 0.25), intensity_m2=200.0)
NOTHING = OpacityGrid.of(np.zeros((0, 3)), np.zeros(0), np.zeros(0))


@pytest.fixture(scope="module")
def yard() -> Scene:
    """Gray level ground with a red wall, by day, without a sky."""
    ground = flat_patch((-15, -15, 0), (30, 0, 0), (0, 30, 0), (0.5, 0.5, 0.5), 0.5, 1)
    wall = flat_patch((-15, 12, 0.5), (30, 0, 0), (0, 0, 6), (0.7, 0.3, 0.25), 0.5, 1)
    thin = np.array([1, 1, 0.05], np.float32)
    ground = replace(ground, scales=ground.scales * thin)
    return Scene("yard", (Layer("all", Gaussians.concatenate([ground, wall])),), ground_m=0.0)


@pytest.fixture(scope="module")
def night(yard) -> Scene:
    return run_to_end(night_scene(yard, [LAMP]))


def light_at(points, normal, lamp=LAMP, grid=NOTHING, plants=0.0):
    n = len(points)
    normals = SurfaceNormals(np.tile(np.array(normal, np.float32), (n, 1)), np.ones(n, np.float32))
    plants = np.full(n, plants, np.float32)
    return light_of_lamps(Scene("empty"), [lamp], np.array(points, np.float32), normals, plants, grid, None)


def test_light_falls_with_the_square_of_the_distance_and_the_cosine():
    (below, twice, aside), up = light_at([(5, 0, 3), (5, 0, 0), (9, 0, 3)], (0, 0, 1)), np.array(LAMP.color)
    assert below == pytest.approx(200 / 9 / np.pi * up, rel=1e-5)
    assert twice == pytest.approx(below / 4, rel=1e-5)
    assert aside == pytest.approx(200 / 25 * 0.6 / np.pi * up, rel=1e-5)
    assert not light_at([(5, 0, 3)], (0, 0, -1)).any() and light_at([(5, 0, 3)], (0, 0, -1), plants=1.0).all()


def test_a_cone_ends_and_what_is_in_the_way_casts_a_shadow():
    down = Lamp(position=LAMP.position, intensity_m2=200.0, inner_deg=20.0, outer_deg=30.0)
    inside, outside = light_at([(6, 0, 0), (11, 0, 0)], (0, 0, 1), down)
    assert inside[0] == pytest.approx(200 / 37 * 6 / 37**0.5 / np.pi, rel=1e-5) and not outside.any()
    x, y = np.meshgrid(np.arange(3, 7, 0.1), np.arange(-2, 2, 0.1))
    roof = np.stack([x.ravel(), y.ravel(), np.full(x.size, 3.0)], axis=1)
    grid = OpacityGrid.of(roof, np.full(len(roof), 0.2), np.full(len(roof), 0.1))
    under, beyond = light_at([(5, 0, 0), (14, 0, 0)], (0, 0, 1), grid=grid)
    free = light_at([(5, 0, 0), (14, 0, 0)], (0, 0, 1))
    assert under[0] < 0.01 * free[0, 0] and beyond == pytest.approx(free[1], rel=1e-3)


def test_level_ground_is_asphalt_under_the_lamp(yard, night):
    layer = night.member("layers/all")
    g, colors = layer.gaussians, np.clip(0.5 + SH_C0 * layer.gaussians.sh[:, 0], 0, 1)
    inner = (g.means[:, 2] == 0) & (np.abs(g.means[:, :2]).max(axis=1) < 10)
    light = -np.log(1 - srgb_to_linear(colors[inner].astype(np.float64)))
    expected = 0.15 * light_at(g.means[inner], (0, 0, 1))
    near = expected[:, 0] > 0.02
    assert np.count_nonzero(near) > 500
    ratio = light[near, 0] / expected[near, 0]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.06) and ratio.std() < 0.16  # grain of its colors
    wet = np.clip(0.5 + SH_C0 * layer.wet_sh[inner, 0], 0, 1)
    assert wet.mean() < 0.9 * colors[inner].mean()
    assert night.water is not None and night.lamps == (LAMP,)
    names = {each.name: each for each in night.layers}
    assert names["lamps"].gaussians.means[0] == pytest.approx(LAMP.position) and names["sky"].kind == "sky"
    assert yard.layers[0].gaussians.means is g.means


@pytest.mark.street
def test_a_drive_gets_lanterns_at_its_right_and_an_object_two_lamps(yard):
    track = PoseTrack(np.array([0.0, 1.0]), np.array([[-9.0, 0, 1.5], [-4.0, 0, 1.5]]),
                      np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))  # fmt: skip
    driven = run_to_end(night_scene(replace(yard, ego=track)))
    places = np.array([lamp.position for lamp in driven.lamps])
    assert np.diff(places[:, 0]) == pytest.approx(SPACING_M) and places[:, 1] == pytest.approx(-RIGHT_M)
    assert places[:, 2] == pytest.approx(LANTERN_HEIGHT_M, abs=0.05)
    assert len(driven.member("layers/lanterns").gaussians) > 100
    pot = replace(yard.layers[0], gaussians=yard.layers[0].gaussians.take(np.arange(3600, 4300)))
    assert [lamp.name for lamp in run_to_end(night_scene(Scene("pot", (pot,)))).lamps] == ["front lamp", "back lamp"]


def test_lit_lenses_of_traffic_lights_shine_away_from_their_housing(yard):
    lens = flat_patch((0, 0, 5), (0, 0.2, 0), (0, 0, 0.2), (1.0, 0.2, 0.15), 0.03, 1)
    housing = flat_patch((0.1, -0.1, 4.5), (0, 0.4, 0), (0, 0, 1.2), (0.05, 0.05, 0.05), 0.05, 2)
    own = Gaussians.concatenate([lens, housing])
    own = replace(own, scales=own.scales * np.array([0.05, 1, 1], np.float32))
    lights = replace(yard, layers=(*yard.layers, Layer("traffic lights", own)))
    relit = run_to_end(night_scene(lights))
    lamp = relit.lamps[-1]
    assert lamp.name == "traffic light 1" and lamp.position == pytest.approx((0, 0.1, 5.1), abs=0.03)
    assert lamp.direction == pytest.approx((-1, 0, 0), abs=0.02) and lamp.color[0] == 1 > 10 * lamp.color[1]
    given = run_to_end(night_scene(lights, []))
    assert given.lamps == ()  # those that are given, none, are all
    light = display_light(given.member("layers/traffic lights"))
    assert light[: len(lens), 0].min() > 0.9 and light[len(lens) :].max() < 0.1
    sign = replace(lights, layers=(*yard.layers, Layer("signs", own)))
    assert display_light(run_to_end(night_scene(sign, [])).member("layers/signs")).max() < 0.1


def display_light(layer):
    return srgb_to_linear(np.clip(0.5 + SH_C0 * layer.gaussians.sh[:, 0], 0, 1).astype(np.float64))


def test_the_command_writes_the_same_bytes_twice_and_refuses_a_night(yard, tmp_path, capsys):
    write_scene(yard, tmp_path / "day")
    lamps = tmp_path / "lamps.yaml"
    lamps.write_text("- {name: one, position: [5, 0, 6], color: [1, 0.5, 0.25], intensity_m2: 200}\n", "utf-8")
    for name in ("a", "b"):
        assert run(["night", str(tmp_path / "day"), "-o", str(tmp_path / name), "--lamps", str(lamps)]) == 0
    first, second = (sorted(path for path in (tmp_path / name).rglob("*") if path.is_file()) for name in ("a", "b"))
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second] and len(first) > 4
    read = load_scene(tmp_path / "a")
    assert read.lamps == (LAMP,) and read.has_rainy_light and read.water is not None
    capsys.readouterr()
    assert run(["night", str(tmp_path / "a"), "-o", str(tmp_path / "c")]) == BAD_INPUT
    assert "dark already" in capsys.readouterr().err and not (tmp_path / "c").exists()


def test_the_edit_takes_lamps_and_their_file(yard, night, tmp_path):
    (tmp_path / "lamps.yaml").write_text("- {name: one, position: [5, 0, 6], color: [1, 0.5, 0.25], intensity_m2: 200}")
    for lamps in ([LAMP], tmp_path / "lamps.yaml"):
        found = gr.edit(yard, "night", lamps=lamps)
        assert found.lamps == (LAMP,)
        assert np.array_equal(found.member("layers/all").gaussians.sh, night.member("layers/all").gaussians.sh)
    assert gr.edit(yard, "night", lamps="none").lamps == ()
    with pytest.raises(ValueError, match="dark already"):
        gr.edit(night, "night")


def test_the_job_of_the_window_is_one_step_that_can_be_repeated(yard):
    (command,) = [each for each in all_commands() if each.name == "Relight for night"]
    with closing(Editor(yard)) as editor:
        command.perform(editor)
        assert not command.can_run(editor)
        editor.document.edit("Lock", set_locked, "layers/all", True)  # what is lit stays
        job = editor.jobs.all[-1]
        job.wait(60)
        settle(editor)
        document = editor.document
        message = "2 lamps (Rain panel, Lamps); new in the Layers panel: lamps and sky"
        assert (job.progress.message, document.history.labels[1:]) == (message, ["Lock", "Relight for night"])
        _, step = steps_since(document.history, document.history.steps[0].document)
        made = document.scene.member("layers/all")
        assert made.locked and command.can_run(editor)
    again = apply_steps(yard, [EditStep.parse(step.text)])
    assert step.text == "night" and np.array_equal(again.member("layers/all").gaussians.sh, made.gaussians.sh)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("room.ply -o out --lamps dim", "lamps dim: no such file"),
        ("room.ply -o holds", "holds"),
        ("none.ply -o file/below/x", "file is a file"),
        ("none.ply -o ok --json file/below/x", "file is a file"),
    ],
)
def test_bad_input_is_one_line_that_names_it(line, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_scene(small_scene(), tmp_path / "room.ply")
    (tmp_path / "holds").mkdir()
    for name in ("holds/mine.txt", "file"):
        (tmp_path / name).write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    assert run(["night", *line.split()]) == BAD_INPUT
    (error,) = capsys.readouterr().err.splitlines()
    assert words in error and sorted(tmp_path.rglob("*")) == before
