"""The viewport's camera, picking and adaptive quality."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.editor.autosave import restore_view, saved_scene
from gsrain_engine.editor.background import Background
from gsrain_engine.editor.clock import PlaybackClock
from gsrain_engine.editor.document import Document, DocumentState
from gsrain_engine.editor.edits.layers import remove
from gsrain_engine.editor.status import StatusBus
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.editor.viewport.camera import NavigationMotion, OrbitCamera, find_scene_core, home_camera, is_in_view
from gsrain_engine.editor.viewport.options import (
    BACKDROP_LEVELS,
    CUT_LEVELS,
    FULL_QUALITY,
    LEVELS,
    REFINED,
    AdaptiveQuality,
    ViewOptions,
)
from gsrain_engine.editor.viewport.picking import pick, pick_point
from gsrain_engine.editor.viewport.picture_rate import PictureRate
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import Layer, Scene
from small_scene import small_scene

WIDTH, HEIGHT = 96, 64


def blob(means, sigma=0.02):
    f, n = np.float32, len(means)
    turns = np.tile(np.array([1, 0, 0, 0], f), (n, 1))
    colors = sh_from_color(np.linspace(0.1, 0.9, 3 * n).reshape(n, 3).astype(f))
    return Gaussians(np.asarray(means, f), np.full((n, 3), sigma, f), turns, np.full(n, 0.9, f), colors)


def cube(count=1000, at=(0, 0, 0), side=2.0):
    return np.random.default_rng(3).uniform(-side / 2, side / 2, (count, 3)) + at


def dome():
    """A blue half sphere of large Gaussians."""
    directions = np.random.default_rng(4).normal(size=(400, 3))
    directions[:, 2] = np.abs(directions[:, 2])
    sky = blob(40.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True), 4.8)
    return sky.with_sh(sh_from_color(np.tile(np.array([0.3, 0.5, 0.9], np.float32), (400, 1))))


def scene_of(*gaussians):
    return Scene("scene", tuple(Layer(f"{k}", each) for k, each in enumerate(gaussians)))


def viewport_of(scene):
    clock = PlaybackClock()
    document = Document(DocumentState(scene, RainSettings()), clock, StatusBus())
    return ViewportState(document, Playback(document, clock), Background())


SHAPES = {
    "one": blob(np.array([[5.0, 6, 7]]), 2.0),
    "plane": blob(cube() * [1, 1, 0]),
    "line": blob(cube() * [1, 0, 0]),
    "strays": blob(np.concatenate([cube(), cube(30, (0, 0, 0), 4000.0)])),
    "in a dome": Gaussians.concatenate([blob(cube()), dome()]),
    "two clusters": blob(np.concatenate([cube(500), cube(500, (60, 0, 0))])),
    "not numbers": blob(np.concatenate([cube(), np.full((40, 3), np.nan)])),
    "stacked": blob(np.zeros((50, 3)), 0.5),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (HEIGHT, 2 * HEIGHT)])
def test_first_views_show_what_is_there(shape, size):
    scene = scene_of(SHAPES[shape])
    core = find_scene_core(scene)
    renderer = CpuRenderer()
    renderer.draw(scene.parts(), home_camera(scene, *size))
    picture = renderer.read().rgba  # over black
    lit = picture.max(axis=2) > 0.05 if core.shell is None else picture[..., 0] - picture[..., 2] > -0.2
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    assert max(np.ptp(rows) / size[1], np.ptp(columns) / size[0]) > 0.45
    assert core.radius_m < (40 if shape == "two clusters" else 8)
    assert (core.shell is not None) == (shape == "in a dome")


def test_f_frames_the_layer_that_is_chosen():
    """A large layer of few Gaussians next to a small one of many: the scene's core is the small one."""
    viewport = viewport_of(scene_of(blob(cube(3000, side=0.3)), blob(cube(300, at=(40, 0, 0), side=30), sigma=1)))
    for member, closest, farthest, middle in (("", 0, 2, 0), ("layers/1", 15, 100, 40), ("layers/none", 0, 2, 0)):
        viewport.options.member = member
        viewport.frame_scene()
        assert closest < viewport.navigation.distance_m < farthest
        assert np.linalg.norm(viewport.navigation.target - [middle, 0, 0]) < 3


def test_rows_are_chosen_as_in_every_list():
    scene = scene_of(*(blob(cube(300, at=(10.0 * each, 0, 0), side=1)) for each in range(4)))
    viewport = viewport_of(scene)
    keys = [each.key for each in scene.members]

    def chosen():
        return [keys.index(each.key) for each in viewport.chosen_members]

    assert chosen() == [] and viewport.active_member is None and viewport.chosen_title == ""
    viewport.choose(keys[1])
    viewport.choose_range(keys[3])
    assert chosen() == [1, 2, 3] and viewport.active_member is scene.members[3]
    viewport.choose_range(keys[0])  # from where the last one began
    assert chosen() == [1, 0]
    viewport.choose_also(keys[3])
    assert chosen() == [1, 0, 3] and viewport.chosen_title == "3 layers"
    viewport.choose_also(keys[1])
    assert chosen() == [0, 3] and viewport.active_member is scene.members[3]
    viewport.choose_range(keys[2], adds=True)
    assert chosen() == [0, 3, 2]
    viewport.choose_all()
    assert chosen() == [0, 1, 3, 2]
    viewport.frame_scene()
    assert viewport.navigation.target[0] == pytest.approx(15, abs=3) and viewport.navigation.distance_m > 15
    viewport.document.edit("Remove", remove, keys[1])
    assert [each.key for each in viewport.chosen_members] == [keys[0], keys[3], keys[2]]
    viewport.options.member = keys[0]  # one of them: the others stay
    assert len(viewport.chosen_members) == 3
    viewport.document.edit("Remove", remove, keys[0])
    assert viewport.chosen_members == [] and viewport.active_member is None
    viewport.choose(keys[3])
    viewport.choose_also(keys[3])
    assert viewport.chosen_members == []


PLACES = {
    "far away": (np.array([4e4, -3e4, 500.0]), 2.0, 0.3),
    "outside of the dome, looking away": (np.array([90.0, 0, 5]), 0.0, 0.0),
    "inside of the dome, looking up": (np.array([-20.0, 10, 3]), 1.0, 1.5),
    "below": (np.array([0.0, 0, -25]), 0.0, -1.5),
    "in the middle": (np.array([0.1, 0, 0]), -2.0, 0.5),
    "no number": (np.array([np.nan, 0, 0]), np.nan, 0.0),
    "beyond all numbers": (np.array([1e300, 0, 0]), 0.5, np.inf),
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("key", ["F", "Home", "wheel in", "wheel out"])
def test_keys_and_wheel_lead_back_from_everywhere(place, key):
    viewport = viewport_of(scene_of(SHAPES["in a dome"]))
    viewport.navigation, core = OrbitCamera(*PLACES[place]), viewport.core
    for _ in range(200 if "wheel" in key else 1):
        {
            "F": viewport.frame_scene,
            "Home": viewport.go_home,
            "wheel in": lambda: viewport.dolly(1.0),
            "wheel out": lambda: viewport.dolly(-1.0),
        }[key]()
    eye = viewport.navigation
    distance = np.linalg.norm(eye.position - core.middle)
    assert np.isfinite([*eye.position, eye.heading, eye.pitch, eye.distance_m]).all()
    assert is_in_view(core, eye.position, eye.forward, eye.vertical_fov_deg)
    if key != "wheel out":  # which does not go on outside of the dome, nor come back
        assert distance < 0.8 * core.shell.radius_m
    elif place not in ("far away", "outside of the dome, looking away"):
        assert distance <= core.farthest_m


@pytest.fixture
def shot():
    matrix = look_at(np.array([-4.0, 0, 3]), np.array([10.0, 0, 1]), np.array([0.0, 0, 1]))
    return RenderView(Camera.from_fov(320, 240, 50.0, matrix))


def on_plane(shot, x, y, axis, at):
    """Intersection of a pixel's line of sight with a plane."""
    camera = shot.camera
    sight = camera.world_to_camera[:3, :3].T @ [(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0]
    return camera.position + (at - camera.position[axis]) / sight[axis] * sight


@pytest.mark.parametrize("pixel", [(160, 200), (90.5, 180), (250, 230)])
def test_a_pixel_of_the_road_is_a_point_of_the_road(shot, pixel):
    point = pick_point(small_scene(), shot, *pixel)
    assert point == pytest.approx(on_plane(shot, *pixel, axis=2, at=0.0), abs=0.05)
    assert pick(small_scene(), shot, *pixel).key == "layers/road"


def test_what_is_hidden_faint_or_not_asked_for_is_seen_through(shot):
    scene = small_scene()
    assert pick(scene, shot, 160, 80).key == "layers/wall"
    for field, value in (
        ("marks", SelectionFlags(deleted=BitMask.all(400))),
        ("gaussians", replace(scene.layers[1].gaussians, opacities=np.full(400, 0.02, np.float32))),
        ("visible", False),
    ):
        assert pick(scene.with_member("layers/wall", **{field: value}), shot, 160, 80).key == "layers/sky"
    assert pick(scene, shot, 160, 80, lambda member: member.name == "sky").key == "layers/sky"


# Adaptive quality


def drive(budget, cost, frames):
    """Move for so many frames; returns what each one was drawn with."""
    details = []
    for _ in range(frames):
        detail = budget.observe(moving=True, real_s=0.03)
        budget.measured(detail, cost(detail))
        details.append(detail)
    return details


def test_rain_over_what_stands_still_needs_fewer_pixels_but_no_fewer_gaussians():
    budget = AdaptiveQuality()

    def played(cost_ms, frames, **state):
        for _ in range(frames):
            detail = budget.observe(moving=True, real_s=0.05, **state)
            budget.measured(detail, cost_ms * (detail.scale if detail.has_backdrop else detail.gaussians))
        return detail

    assert played(20.0, 4, stands=True).is_exact  # fast enough as it is
    assert not played(400.0, 4, stands=False).has_backdrop  # the camera moves
    assert budget.observe(moving=True, real_s=0.05, stands=True).gaussians < 1  # or did just now
    over = played(90.0, 30, stands=True)
    assert over.has_backdrop and not over.is_exact
    assert (over.gaussians, over.scale) == (1.0, 0.5)
    assert "still scene, 50% resolution" in str(over)
    assert played(150.0, 30, stands=True).scale == 1 / 3  # the coarsest
    assert played(10.0, 80, stands=True).scale == 1.0
    assert not budget.observe(moving=True, real_s=0.05, stands=False).has_backdrop
    assert budget.observe(moving=False, real_s=1.0).is_exact


def test_details_are_merged_where_they_can_be_and_the_settled_level_outlasts_a_pause():
    budget = AdaptiveQuality(target_ms=33.0, has_cuts=True)

    def cost(detail):
        return 400.0 if detail.is_exact else 30.0 + 200.0 * detail.scale**2

    drive(budget, cost, 20)
    settled = budget.observe(moving=True, real_s=0.03)
    assert settled.error_px > 0 and settled.gaussians == 1 and "px merged" in str(settled)
    assert 33 < cost(settled) < 76  # longer than the target, but what it shows is the scene
    budget.observe(moving=False, real_s=1.0)
    budget.measured(FULL_QUALITY, 400.0)
    assert budget.observe(moving=True, real_s=0.03) == settled
    budget.has_cuts = False  # other Gaussians, whose details have yet to be merged
    assert budget.observe(moving=True, real_s=0.03).gaussians < 1
    budget.has_cuts = True
    assert drive(budget, lambda detail: 5.0 * detail.scale, 60)[-1].is_exact


def test_the_shortest_target_is_what_the_coarsest_pictures_take():
    budget = AdaptiveQuality(target_ms=10.0)
    drive(budget, lambda detail: 30.0, 2)
    assert budget.min_target_ms == 0.0  # not known yet
    drive(budget, lambda detail: 90.0 if detail == LEVELS[-1] else 400.0, 20)
    assert budget.min_target_ms == pytest.approx(90.0)
    budget.target_ms = 150.0
    assert budget.min_target_ms == pytest.approx(90.0)  # of the machine, whatever is asked for
    drive(budget, lambda detail: 20.0, 40)  # another scene
    assert budget.min_target_ms == pytest.approx(20.0)
    for _ in range(5):
        budget.measured(BACKDROP_LEVELS[-1], 120.0)
    assert budget.min_target_ms == pytest.approx(80.0)  # those may take longer: no answer to the mouse waits
    budget.is_warped = True
    assert budget.min_target_ms == pytest.approx(80.0)


def test_a_pause_refines_the_picture_before_a_full_one_that_takes_long():
    def paused(full_ms, has_cuts=True):
        budget = AdaptiveQuality(has_cuts=has_cuts)
        drive(budget, lambda detail: full_ms if detail.is_exact else 60.0, 4)
        shown = []
        for rested_s in (0.1, 0.1, 0.1, 0.1):
            shown.append(budget.observe(moving=False, real_s=rested_s))
            budget.measured(shown[-1], full_ms if shown[-1].is_exact else 60.0)
        return budget, shown

    budget, (moving, *shown) = paused(1500.0)
    assert moving == budget.observe(moving=True, real_s=0.03) and shown == [REFINED, FULL_QUALITY, FULL_QUALITY]
    assert paused(1500.0, has_cuts=False)[1][1:] == paused(400.0)[1][1:] == [FULL_QUALITY] * 3
    assert paused(100.0)[1][1:] == [FULL_QUALITY] * 3


@given(st.floats(0, 2000), st.floats(0, 300), st.floats(10, 100), st.booleans())
def test_holds_the_target_where_any_level_can(by_gaussians, by_pixels, target, has_cuts):
    budget = AdaptiveQuality(target_ms=target, has_cuts=has_cuts)

    def cost(detail):
        share = detail.gaussians / (1 + detail.error_px)
        return 2.0 + by_gaussians * share + by_pixels * detail.scale**2

    details = drive(budget, cost, 200)
    fastest = min(cost(level) for level in (CUT_LEVELS if has_cuts else LEVELS))
    late = [(cost(each), each.patience) for each in details[8:]]
    slow = sum(ms > 1.16 * max(patience * target, fastest) for ms, patience in late)
    assert slow <= 1 + len(late) // 40  # but for a try of the finer level now and then


def test_at_first_nothing_but_a_selection_is_drawn_over_the_picture_and_no_page_is_open():
    options = ViewOptions()
    assert (options.look, options.split, options.gain_ev, options.shrink) == ("splats", "off", 0, 1)
    assert (options.dialog, options.member, options.tool, options.lamp) == ("", "", "", -1)
    assert options.show_selection and not options.show_lamps and not options.follow_path


def test_turning_upwards_shows_what_is_above_and_ends_at_the_zenith():
    navigation = OrbitCamera(heading=0.3, pitch=-0.1)
    navigation.turn(0.0, 0.4)
    assert navigation.pitch == pytest.approx(0.3)
    assert navigation.camera(WIDTH, HEIGHT).camera_to_world[2, 2] == pytest.approx(np.sin(0.3))
    navigation.turn(0.0, 9.0)
    assert navigation.pitch == np.pi / 2
    assert navigation.camera(WIDTH, HEIGHT).camera_to_world[2, 2] == pytest.approx(1.0)


def moved(navigation, motion, frames, step):
    for frame in range(frames):
        motion.observe(navigation, 0.05 * frame)
        step(navigation)
    motion.observe(navigation, 0.05 * frames)


def test_a_moving_camera_is_expected_to_go_on_and_one_that_stands_to_stay():
    navigation, motion = OrbitCamera(heading=np.pi - 0.05), NavigationMotion()
    assert motion.expected(navigation, 0.2) is navigation
    moved(navigation, motion, 5, lambda each: (each.fly(1, 0, 0, 0.05), each.turn(0.02, 0.01)))
    later = motion.expected(navigation, 0.2)
    ahead_m = np.linalg.norm(later.position - navigation.position)
    assert 0.5 < ahead_m / (0.2 * navigation.speed_m_s) < 1.0
    turned = np.mod(later.heading - navigation.heading, 2 * np.pi)  # over the seam at 180 degrees
    assert 0.5 < turned / (0.2 * 0.02 / 0.05) < 1.0 and later.pitch > navigation.pitch
    moved(navigation, motion, 4, lambda each: None)
    assert motion.expected(navigation, 0.2) is navigation


def test_a_jump_to_another_place_is_no_motion():
    navigation, motion = OrbitCamera(), NavigationMotion()
    moved(navigation, motion, 4, lambda each: None)
    navigation.position = np.array([100.0, 0.0, 1.5])
    moved(navigation, motion, 1, lambda each: None)
    assert motion.expected(navigation, 0.2) is navigation


def test_a_view_ahead_of_time_is_that_of_the_path_then_and_time_stands_while_paused():
    viewport = viewport_of(small_scene())
    clock = viewport.playback.clock
    viewport.ride(True)
    clock.seek(1.0)
    clock.speed = 2.0
    ahead = viewport.shot(WIDTH, HEIGHT, ahead_s=0.5)
    clock.seek(2.0)
    then = viewport.shot(WIDTH, HEIGHT)
    assert ahead.time_s == then.time_s == 2.0
    assert np.array_equal(ahead.camera.world_to_camera, then.camera.world_to_camera)
    end = viewport.playback.span_s[1]
    clock.seek(end - 0.1)
    assert viewport.shot(WIDTH, HEIGHT, ahead_s=0.5).time_s == pytest.approx(0.9)  # from the start once more
    assert clock.time_s == end - 0.1
    clock.playing = False
    assert viewport.shot(WIDTH, HEIGHT, ahead_s=0.5).time_s == clock.time_s


def test_pictures_that_are_warped_may_take_longer_unless_the_camera_stands():
    def settled(is_warped, **state):
        budget = AdaptiveQuality(has_cuts=True, is_warped=is_warped)
        for _ in range(60):
            detail = budget.observe(moving=True, real_s=0.2, **state)
            budget.measured(detail, 20.0 + 300.0 * detail.scale**2)
        return detail.scale

    assert settled(True) > 1.5 * settled(False)
    assert settled(True, stands=True) == settled(False, stands=True)


def from_above():
    viewport = viewport_of(small_scene())
    viewport.look_from_above()
    return viewport


def place_of(viewport, point_m, size=(WIDTH, HEIGHT)):
    camera = viewport.shot(*size).camera
    return camera.pixels((camera.world_to_camera[:3, :3] @ point_m + camera.world_to_camera[:3, 3])[None])[0]


def test_a_view_from_above_shows_all_of_the_scene_with_y_upwards():
    viewport = from_above()
    core, camera = viewport.core, viewport.shot(WIDTH, HEIGHT).camera
    assert camera.is_orthographic
    corners = [place_of(viewport, corner) for corner in (core.low, core.high)]
    assert 0 <= corners[0][0] < corners[1][0] <= WIDTH and 0 <= corners[1][1] < corners[0][1] <= HEIGHT
    assert max(corners[1][0] - corners[0][0], corners[0][1] - corners[1][1]) > 0.8 * HEIGHT


def test_the_wheel_scales_an_orthographic_view_and_a_pivot_keeps_its_scale():
    viewport = from_above()
    before, target = viewport.shot(WIDTH, HEIGHT).camera.pixels_per_m, viewport.navigation.target
    viewport.dolly(3)
    assert viewport.shot(WIDTH, HEIGHT).camera.pixels_per_m == pytest.approx(before / 0.9**3)
    assert place_of(viewport, target) == pytest.approx((WIDTH / 2, HEIGHT / 2), abs=1e-3)
    scale, pose = viewport.shot(WIDTH, HEIGHT).camera.pixels_per_m, place_of(viewport, np.array([10.0, 1, 0]))
    assert viewport.set_pivot(30, 30, WIDTH, HEIGHT)
    assert viewport.shot(WIDTH, HEIGHT).camera.pixels_per_m == pytest.approx(scale)
    assert place_of(viewport, np.array([10.0, 1, 0])) == pytest.approx(pose, abs=1e-2)
    on_ground = viewport.navigation.pivot
    assert on_ground is not None and abs(on_ground[2]) < 1 and place_of(viewport, on_ground) == pytest.approx((30, 30))
    viewport.orbit(0.4, 0.3)
    assert place_of(viewport, on_ground) == pytest.approx((30, 30), abs=1e-2)


def test_an_orthographic_view_flies_across_and_ends_where_the_camera_is_set():
    viewport = from_above()
    height_m = viewport.navigation.position[2]
    viewport.navigation.fly(1, 0, 0, 1.0, across=True)
    assert viewport.navigation.position[2] == pytest.approx(height_m) and viewport.navigation.velocity_m_s[1] > 1
    viewport.look_from(
        Camera.from_fov(WIDTH, HEIGHT, 50.0, look_at(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, 1.0])))
    )
    assert not viewport.shot(WIDTH, HEIGHT).camera.is_orthographic
    viewport.look_from_above()
    viewport.go_home()
    assert not viewport.shot(WIDTH, HEIGHT).camera.is_orthographic and viewport.marks == ()


def test_an_orthographic_view_is_saved_with_the_scene():
    viewport, other = from_above(), viewport_of(small_scene())
    restore_view(other, saved_scene(viewport).view)
    seen, again = (each.shot(WIDTH, HEIGHT).camera for each in (viewport, other))
    np.testing.assert_array_equal(again.world_to_camera, seen.world_to_camera)
    assert again.pixels_per_m == seen.pixels_per_m and again.is_orthographic


def test_the_pictures_on_the_screen_are_counted_and_named_by_size():
    rate = PictureRate()
    assert rate.words(0.0) == ""
    for number in range(30):
        rate.note_drawing(0.125 * number, (480, 320), is_exact=False)
    assert rate.words(3.7) == "8 pictures/s at 480 x 320"
    for number in range(1, 31):
        rate.note_displayed(3.7 + 0.05 * number)
        if number % 4 == 0:
            rate.note_drawing(3.701 + 0.05 * number, (320, 200), is_exact=False)
    assert rate.words(5.3) == "25 pictures/s, 5 drawn at 320 x 200"
    assert rate.words(9.0) == "320 x 200, an exact one follows"
    rate.note_drawing(9.0, (1440, 900), is_exact=True)
    assert rate.words(9.1) == rate.words(12.0) == "exact, 1,440 x 900"
