"""The web page of a scene: drops, pictures and files, as headless Chromium shows them."""

import base64
import hashlib
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from PIL import Image
from scipy.spatial import cKDTree

from browser import CHROMIUM, browser
from gsrain_engine.backends import open_renderer
from gsrain_engine.publish.page import base85, opening_view, publish_page, write_page
from gsrain_engine.publish.page_scene import CODES, WET_STEPS, finer_means, page_scene, wet_files
from gsrain_engine.publish.rain_states import rain_states
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
from gsrain_engine.render.passes.splashes import draw_splashes
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.view import rain_camera
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.formats.sog import read_sog
from gsrain_engine.scene.formats.sog_writer import coded, mean_steps
from gsrain_engine.scene.gaussians import SH_C0, Gaussians, sh_from_color
from gsrain_engine.scene.geometry import quaternions_from_matrices
from gsrain_engine.scene.ground_water import GroundWater
from gsrain_engine.scene.named_view import NamedView
from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, Scene
from small_scene import patch, small_scene

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
RAIN = RainSettings(intensity_mm_h=8.5, seed=5, wind_speed_m_s=6.0, gust_m_s=1.5, spray=False)
TIMES_S = 0.4, 1.5
SIZE = 320, 240


def wet_hill():
    """Water on a road that rises, with more of it in the middle."""
    x, y = np.meshgrid(-10 + 0.5 * (np.arange(140) + 0.5), -20 + 0.5 * (np.arange(80) + 0.5))
    cover = np.zeros((80, 140, 2), np.uint8)
    cover[(x > 0) & (abs(y) < 5)] = 220, 30
    cover[(x > 8) & (x < 20) & (abs(y) < 3)] = 60, 190
    return GroundWater((-10.0, -20.0), 0.5, cover, (0.03 * x - 0.01 * y).astype(np.float32))


def rainy_scene():
    """A road, a wall and a roof with wet colors, and a block that moves; no vehicle carries the rain."""
    scene, water = small_scene(), wet_hill()
    road = scene.layers[0].gaussians
    places = road.means + water.height_at(road.means[:, :2])[:, None] * np.array([0, 0, 1], np.float32)
    scene = replace(scene, layers=(Layer("road", replace(road, means=places)), *scene.layers[1:]))
    roof = patch((4, -2, 3.5), np.array([3.0, 0, 0]), np.array([0, 4.0, 0]), 30, (0.5, 0.2, 0.2))
    # At equal depths, the first one is the nearest.
    sides = (14, 3, 1.5), np.array([0, 3.0, 0]), np.array([0, 0, 2.0]), 20
    red, green = (Layer(f"board {at}", patch(*sides, color)) for at, color in enumerate([(0.9, 0, 0), (0, 0.9, 0)]))
    layers = [
        replace(layer, wet_sh=0.6 * layer.gaussians.sh - np.float32(0.3))
        for layer in (*scene.layers, Layer("roof", roof), red, green)
    ]
    block = patch((-1, -0.5, 0.5), np.array([0, 1.0, 0]), np.array([0, 0, 1.0]), 12, (0.9, 0.2, 0.1))
    times = np.linspace(0, 4, 5)
    track = PoseTrack(times, np.stack([12 + times, 2 * times - 3, 0 * times], axis=1),
                      np.tile([1.0, 0, 0, 0], (5, 1)), np.ones(5, bool))  # fmt: skip
    actor = Actor("block", "car", (1.0, 1.0, 1.0), block, track)
    return Scene("wet road", tuple(layers), (actor,), ground_m=0.0, water=water)


def path():
    poses = [look_at(np.array([x, 0.4 * x, 1.6]), np.array([20.0, 2.0, 2.0]), np.array([0, 0, 1.0])) for x in (0, 4, 9)]
    turns = quaternions_from_matrices(np.array([np.linalg.inv(each)[:3, :3] for each in poses]))
    places = np.array([np.linalg.inv(each)[:3, 3] for each in poses])
    return CameraPath(np.array([0.0, 1.0, 2.0]), places, turns, np.full(3, 55.0), interpolation="linear")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    file = tmp_path_factory.mktemp("page") / "rain.html"
    scene = rainy_scene()
    dry = structs.replace(RAIN, intensity_mm_h=0.0)  # the slider has rain all the same
    sequence = FrameSequence(scene, RainSimulation.start(dry), path(), *SIZE)
    with open_renderer("cpu") as renderer:
        steps = write_page(renderer, scene, dry, sequence, "a path", file)
        while True:
            try:
                next(steps)
            except StopIteration as end:
                return file, end.value, sequence


@pytest.fixture(scope="module")
def page(written, tmp_path_factory):
    with browser(tmp_path_factory.mktemp("browser")) as opened:
        opened.open(written[0], *SIZE)
        opened.run("gsrain.ready.then(() => true)")
        yield opened


def rainy_at(sequence, intensity, **changes):
    rain = structs.replace(RAIN, intensity_mm_h=intensity, **changes)
    return replace(sequence, rainfall=RainSimulation.start(rain))


def on_page(page, intensity, time_s):
    picture = page.run(f"gsrain.image({{mm: {intensity}, t: {time_s}, split: 0, size: '{SIZE[0]}x{SIZE[1]}'}})")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(picture.split(",")[1]))).convert("RGB"), np.float64)


def on_desktop(sequence, time_s):
    with open_renderer("cpu") as renderer:
        return replace(sequence, start_s=time_s).image(renderer, 0, sequence.sky(renderer)).astype(np.float64)


def decibels(ours, theirs):
    return 10 * np.log10(255**2 / np.mean((ours - theirs) ** 2))


@needs_browser
@pytest.mark.parametrize("intensity", [2.5, 50.0])
def test_drops_are_those_of_the_desktop(written, page, intensity):
    sequence = rainy_at(written[2], intensity)
    for time_s in TIMES_S:
        page.run(f"gsrain.image({{mm: {intensity}, t: {time_s}, size: '{SIZE[0]}x{SIZE[1]}'}}).then(() => 0)")
        found = {int(row[0]): row[1:] for row in page.run(f"gsrain.drops({time_s}).then(found => found.drops)")}
        shot = sequence.shot_at(time_s)
        drops = sequence.rainfall.frame(time_s, rain_camera(sequence.scene, sequence.rainfall, shot)).drops
        assert len(drops.numbers) > 200
        ours = np.array([found[number] for number in drops.numbers.tolist()])  # each is found
        assert np.abs(ours[:, :3] - drops.positions_m).max() < 1e-3
        np.testing.assert_allclose(ours[:, 3], drops.diameters_mm, rtol=1e-9)
        assert len(found) < 1.2 * len(drops.numbers)  # the page is told nothing of drops out of view


@needs_browser
@pytest.mark.parametrize("intensity", [0.0, 8.5, 50.0])
def test_pictures_are_those_of_the_desktop(written, page, intensity):
    sequence = rainy_at(written[2], intensity)
    for time_s in TIMES_S:
        theirs = on_desktop(sequence, time_s)
        assert theirs.std() > 10
        assert decibels(on_page(page, intensity, time_s), theirs) > 38


@needs_browser
def test_wet_ground_mirrors_the_scene(written, page):
    """On a road that rises, the page reflects the wall, the roof, the sky and the block that moves."""
    theirs, matte = (on_desktop(rainy_at(written[2], 8.5, mirror=mirror), 1.5) for mirror in (True, False))
    wet = np.abs(theirs - matte).max(axis=2) > 20
    assert wet.mean() > 0.2
    assert decibels(matte[wet], theirs[wet]) < 22
    assert decibels(on_page(page, 8.5, 1.5)[wet], theirs[wet]) > 42


@needs_browser
def test_splashes_are_those_of_the_desktop(written, page):
    sequence, time_s = rainy_at(written[2], 50.0), TIMES_S[1]
    page.run(f"gsrain.image({{mm: 50, t: {time_s}, size: '{SIZE[0]}x{SIZE[1]}'}}).then(() => 0)")
    camera = f"withSize(pathCamera({time_s}), canvas.width, canvas.height)"
    rows = np.array(page.run(f"answer({camera}, {time_s}, state.step).then(found => [...found.streaks])")).reshape(
        -1, 12
    )
    shot = sequence.shot_at(time_s)
    frame = sequence.rainfall.frame(time_s, rain_camera(sequence.scene, sequence.rainfall, shot))
    ours = draw_splashes(sequence.scene, sequence.rainfall, frame)
    pose = shot.camera.world_to_camera
    places = ours.means @ pose[:3, :3].T + pose[:3, 3]
    away, nearest = cKDTree(rows[:, :3]).query(places)
    is_upright = ~ours.quaternions[:, 1:3].any(axis=1)
    assert is_upright.sum() > 50
    assert is_upright.sum() == rows[:, 9:].any(axis=1).sum()
    assert away.max() < 0.01  # heights on a page have steps of 5 mm
    found = rows[nearest]
    np.testing.assert_allclose(found[:, 3], ours.opacities, rtol=1e-3)
    np.testing.assert_allclose(found[:, 7], ours.scales[:, 2], rtol=1e-3)
    np.testing.assert_allclose(found[:, 8], ours.scales[:, 1], rtol=1e-3)


@needs_browser
def test_the_divider_shows_the_dry_scene_on_its_left(page):
    def picture_at(split):
        picture = page.run(f"gsrain.image({{mm: 8.5, t: 1, split: {split}, size: '{SIZE[0]}x{SIZE[1]}'}})")
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(picture.split(",")[1]))).convert("RGB"), int)

    dry, rainy, both = picture_at(1), picture_at(0), picture_at(0.5)
    half = SIZE[0] // 2
    assert np.array_equal(both[:, :half], dry[:, :half])
    assert np.array_equal(both[:, half:], rainy[:, half:])
    assert np.abs(dry - rainy).mean() > 5


@needs_browser
def test_title_slider_and_keys(page):
    page.run("gsrain.image({mm: 8.5, t: 1, split: 0, size: '64x48'}).then(() => 0)")
    assert "wet road" in page.run("document.title")
    assert page.run("document.getElementById('intensity-name').textContent").endswith("8.5 mm/h, heavy")
    assert page.run("document.getElementById('divider').hidden") is True
    for key in ("c", "+", "-", "-", " "):
        page.run(f"dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}'}}))")
    assert page.run("document.getElementById('divider').hidden") is False
    assert page.run("document.getElementById('intensity-name').textContent") == "5 mm/h, moderate"
    assert page.run("document.getElementById('play').getAttribute('aria-pressed')") == "true"
    assert page.run("document.getElementById('notice').hidden") is True


@needs_browser
def test_an_address_is_a_view(page):
    view = "#mm=50&split=0.25&t=1.00&camera=1,2.5,1.6,0.5,-0.5,0.5,-0.5,55"
    changed = "new Promise(done => addEventListener('hashchange', () => done(0), {once: true}))"
    page.run(f"location.hash = '{view}', {changed}")
    assert page.run("gsrain.view()") == view
    page.run("dispatchEvent(new KeyboardEvent('keydown', {key: 'Home'}))")
    assert page.run("gsrain.view()") == view.split("&camera")[0]


@needs_browser
def test_fingers_turn_shift_and_pinch(page):
    def camera_after(*moves):
        page.run("gsrain.image({mm: 0, t: 1, camera: '0,0,1.6,0.5,-0.5,0.5,-0.5,55'}).then(() => 0)")
        for kind, finger, x, y in moves:
            event = f"new PointerEvent('{kind}', {{pointerId: {finger}, clientX: {x}, clientY: {y}}})"
            page.run(f"document.getElementById('view').dispatchEvent({event})")
        return np.array(page.run("gsrain.view()").split("camera=")[1].split(","), float)

    page.run("document.getElementById('view').setPointerCapture = () => 0")  # there are no such pointers
    down = ("pointerdown", 1, 100, 100), ("pointerdown", 2, 200, 100)
    turned = camera_after(down[0], ("pointermove", 1, 140, 100), ("pointerup", 1, 140, 100))
    assert np.array_equal(turned[:3], [0, 0, 1.6])
    assert not np.allclose(turned[3:7], [0.5, -0.5, 0.5, -0.5], atol=0.01)
    up = ("pointerup", 1, 0, 0), ("pointerup", 2, 0, 0)
    parted = camera_after(*down, ("pointermove", 1, 90, 100), ("pointermove", 2, 210, 100), *up)
    # Camera x forward: 20 px of spread are 0.4 m, and the middle of both fingers has not moved.
    np.testing.assert_allclose(parted[:3], [0.4, 0, 1.6], atol=1e-6)
    np.testing.assert_allclose(parted[3:7], [0.5, -0.5, 0.5, -0.5], atol=1e-6)


def test_a_page_loads_nothing_and_is_little_more_than_its_scene(written):
    file, contents, _ = written
    text = file.read_text()
    assert " src=" not in text and "url(" not in text
    assert "@import" not in text.split('<script type="text/plain"')[0]
    assert file.stat().st_size < 1.4 * len(contents.scene.sog) + 3e6


def test_a_browser_is_told_to_run_the_scripts_of_the_page_alone(written):
    text = written[0].read_text()
    head, _, rest = text.partition('<meta http-equiv="Content-Security-Policy" content="')
    policy = dict(each.strip().split(" ", 1) for each in rest.partition('"')[0].split(";"))
    assert "<script" not in head and policy["default-src"] == "'none'" and "connect-src" not in policy
    allowed = set(policy["script-src"].split())
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    hashes = [base64.b64encode(hashlib.sha256(each.encode()).digest()).decode() for each in scripts]
    assert len(scripts) == 2 and allowed == {*(f"'sha256-{each}'" for each in hashes), "blob:"}
    assert len(re.findall(r"\son[a-z]+=", text.split('<script type="text/plain"')[0])) == 0


@needs_browser
def test_a_script_from_elsewhere_does_not_run(page):
    made = "const made = document.createElement('script'); made.textContent = 'window.strange = 1'"
    assert page.run(f"(() => {{ {made}; document.body.append(made); return window.strange ?? 0; }})()") == 0
    assert page.run("fetch('data:,x').then(() => 'loaded', () => 'refused')") == "refused"


def test_base85_is_text_that_can_not_end_a_script():
    data = bytes(range(256)) * 3 + b"end"
    text = base85(data)
    assert "<" not in text and len(text) == np.ceil(len(data) * 5 / 4)
    assert base64.b85decode(text.replace(",", "<")) == data


def test_wet_colors_keep_their_values():
    """Colors beyond display black and white, and those far from the dry ones, have the same error as all others."""
    rng = np.random.default_rng(3)
    dry, wet = rng.uniform(-0.2, 1.2, (500, 1, 3)), rng.uniform(-0.9, 1.9, (500, 1, 3))
    dry_sh, wet_sh = (sh_from_color(each[:, 0].astype(np.float32)) for each in (dry, wet))
    files = wet_files(dry_sh, wet_sh)
    meta = json.loads(files["meta.json"])["sh0"]
    differences = np.asarray(Image.open(io.BytesIO(files["sh0.webp"])).convert("RGB")).reshape(-1, 3)[:500]
    steps = (differences + np.array(meta["dry_steps"])[coded(dry_sh[:, 0], CODES)[1]]) % 256
    found = SH_C0 * np.array(meta["codebook"])[steps] + 0.5
    assert np.abs(found - wet[:, 0]).max() < 0.501 / WET_STEPS


def test_means_are_as_fine_as_gaussians_are_small():
    """Far from the origin, a step of a SOG file is as wide as a small Gaussian; along the short axes it is not."""
    rng = np.random.default_rng(4)
    count = 2000
    means = rng.uniform((200, -2, -1), (300, 2, 1), (count, 3)).astype(np.float32)
    means[:2, 0] = -900, 900
    scales = np.full((count, 3), 0.1, np.float32)
    turns, opaque = np.tile(np.float32([1, 0, 0, 0]), (count, 1)), np.full(count, 0.9, np.float32)
    gaussians = Gaussians(means, scales, turns, opaque, sh_from_color(np.full((count, 3), 0.5, np.float32)))
    parts, image = finer_means(gaussians)
    exact, mins, maxs = mean_steps(means)
    rows = np.asarray(Image.open(io.BytesIO(image)).convert("RGB")).reshape(-1, 3)[:count]
    steps = np.rint(exact) + (rows + 0.5) / parts - 0.5
    logarithms = mins + (maxs - mins) * steps / 65535
    found = np.sign(logarithms) * np.expm1(np.abs(logarithms))
    assert parts == [8, 1, 1]
    assert np.abs(found - means)[2:].max() < 0.05 * 0.1
    assert np.abs(found - means)[2:].max() > 0.4 * 0.05 * 0.1


def test_actors_keep_their_numbers_and_poses(tmp_path):
    scene = rainy_scene()
    steps = page_scene(scene, 0.0, 2.0)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            found = end.value
            break
    assert found.poses.shape == (1, 21, 3, 4)
    np.testing.assert_allclose(found.poses[0, 10, :, :3], np.eye(3), atol=1e-5)
    assert np.linalg.norm(found.poses[0, 10, :, 3]) == pytest.approx(np.hypot(1, 2), abs=1e-4)
    (tmp_path / "a.sog").write_bytes(found.sog)
    gaussians = read_sog(tmp_path / "a.sog")
    labels = np.asarray(Image.open(io.BytesIO(found.actors))).reshape(-1, 3)[: len(gaussians), 0]
    assert labels.sum() == len(scene.actors[0].gaussians)
    red = sh_from_color(np.array([[0.9, 0.2, 0.1]], np.float32))[0, 0]
    assert np.abs(gaussians.sh[labels == 1, 0] - red).max() < 0.1


@pytest.mark.parametrize(
    ("change", "words"),
    [({"haze": "gaussians"}, "haze gaussians"), ({"model": "paper"}, "model paper"),
     ({"visibility_m": 200.0}, "visibility_m 200")],
)  # fmt: skip
def test_rain_that_a_page_can_not_draw(change, words):
    with pytest.raises(ValueError, match=words):
        rain_states(structs.replace(RAIN, **change), Scene("x"), {False: OVERCAST, True: OVERCAST}, [], 0.004)


def test_settings_can_not_end_their_script(written, tmp_path):
    text = written[0].read_text()
    settings = text.split('id="settings">')[1].split("</script>")[0]
    assert json.loads(settings)["states"][0]["intensity"] == 0
    assert "<" not in settings


# Named views


def named_views():
    """One above the path with time and rain; one with neither; one out of the ground and roofs on the page."""
    scene, eye = rainy_scene(), np.array([2.0, -3.0, 4.0])
    camera = Camera.from_fov(*SIZE, 40.0, look_at(eye, np.array([20.0, 2.0, 2.0]), np.array([0, 0, 1.0])))
    far = Camera.from_fov(*SIZE, 50.0, look_at(1e5 * eye, np.zeros(3), np.array([0, 0, 1.0])))
    return replace(scene, views=(
        NamedView.of("Bare <wall>", camera.shifted(ahead=2.0)),
        NamedView.of("Gate", camera, time_s=1.5, rain={"intensity_mm_h": 50.0}),
        NamedView.of("Far", far, time_s=9.0),
    ))  # fmt: skip


@pytest.fixture(scope="module")
def with_views(tmp_path_factory):
    folder, scene = tmp_path_factory.mktemp("views"), named_views()
    sequence = FrameSequence(scene, RainSimulation.start(RAIN), path(), *SIZE)
    opening = opening_view(scene, "Gate", has_path=True)
    with open_renderer("cpu") as renderer:
        result = run_to_end(publish_page(renderer, scene, RAIN, sequence, "a path", folder / "a.html", None, opening))
    return result, sequence


def test_the_first_view_opens_a_page_unless_a_path_is_chosen():
    scene = named_views()
    assert opening_view(scene, None, has_path=False) is scene.views[0]
    assert opening_view(scene, None, has_path=True) is None and opening_view(Scene("x"), None, has_path=False) is None
    with pytest.raises(ValueError, match="did you mean 'Gate'"):
        opening_view(scene, "gat", has_path=False)


def test_a_page_lists_the_named_views(with_views):
    result, _ = with_views
    text = result.made.read_text()
    settings = json.loads(text.split('id="settings">')[1].split("</script>")[0])
    assert settings["view"] == 1 and result.numbers["named_views"] == ["Bare <wall>", "Gate", "Far"]
    bare, gate, far = settings["views"]
    np.testing.assert_allclose(gate["camera"][:3], [2.0, -3.0, 4.0], atol=1e-6)
    assert (gate["camera"][7], gate["t"], gate["mm"]) == (40.0, 1.5, 50.0)
    assert bare.keys() == {"name", "camera", "floor"} and far["t"] == 2.0  # where the path ends
    assert '<option value="0">Bare &lt;wall&gt;</option>' in text


@needs_browser
def test_views_of_a_page_are_gone_to_by_list_and_keys(with_views, tmp_path):
    result, sequence = with_views
    with browser(tmp_path) as page:
        page.open(result.made, *SIZE)
        page.run("gsrain.ready.then(() => true)")

        def is_listed():
            return page.run("document.getElementById('views').selectedOptions[0].textContent")

        page.run("act('play')")  # and time stands
        assert is_listed() == "Gate" and "camera=2,-3,4," in page.run("gsrain.view()")
        found = on_page(page, 50.0, 1.5)  # at the camera of the view
        view = replace(rainy_at(sequence, 50.0), camera=sequence.scene.views[1].camera(*SIZE), start_s=1.5)
        assert decibels(found, on_desktop(view, 1.5)) > 38
        page.run("dispatchEvent(new KeyboardEvent('keydown', {key: '1'}))")
        assert is_listed() == "Bare <wall>" and "mm=50&" in page.run("gsrain.view()")
        choose = "const list = document.getElementById('views'); list.value"
        page.run(f"{choose} = '1'; list.dispatchEvent(new Event('change'))")
        assert is_listed() == "Gate" and "t=1.50&" in page.run("gsrain.view()")
        page.run("look(10, 0)")
        assert is_listed() == "Views" and "camera=2,-3,4," in page.run("gsrain.view()")
        page.run("dispatchEvent(new KeyboardEvent('keydown', {key: 'Home'}))")
        assert page.run("gsrain.view()").endswith("view=") and is_listed() == "Views"
        changed = "new Promise(done => addEventListener('hashchange', () => done(0), {once: true}))"
        for address, name in (("view=Bare%20%3Cwall%3E", "Bare <wall>"), ("view=", "Views"), ("mm=5", "Gate")):
            page.run(f"location.hash = '{address}', {changed}")
            assert is_listed() == name
        assert "mm=5&" in page.run("gsrain.view()")
