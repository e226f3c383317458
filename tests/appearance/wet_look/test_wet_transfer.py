"""The whole transfer: nothing at wetness 0, more with more of it, the same twice, and the same from all sides."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from appearance.wet_look.dry_view import camera, dry_view
from gsrain_engine.appearance.base import Transfer
from gsrain_engine.appearance.correspondence import correspondence, warped
from gsrain_engine.appearance.wet_look.environment import ImageEnvironment
from gsrain_engine.appearance.wet_look.settings import WetSettings
from gsrain_engine.appearance.wet_look.translator import WetTransfer

ALLOWED = 1.1
"""Of the clear views' own disagreement."""
DRY = 0.05
"""Share of mirrored light up to which a pixel shows what lies there rather than what the water mirrors."""


@pytest.fixture(scope="module")
def surroundings():
    return ImageEnvironment()


@pytest.fixture(scope="module")
def views():
    eyes = [camera((x, 0.2 * x, 1.5), (1.0, 0.05 * x, -0.1), 192, 128) for x in (0.0, 1.0)]
    return [
        dry_view(shadow=0.7, seen_from=eye, texture=0.2, noise=0.01, name="view" + i * "!")
        for i, eye in enumerate(eyes)
    ]


def rainy(views, surroundings, **settings):
    return list(WetTransfer(WetSettings(**settings), surroundings).transferred(views))


@pytest.fixture(scope="module")
def soaked(views, surroundings):
    return rainy(views, surroundings)


def test_the_same_bytes_twice_in_order_and_none_changed_at_wetness_0(views, surroundings, soaked):
    transfer = WetTransfer(WetSettings(), surroundings)
    assert isinstance(transfer, Transfer) and transfer.name == "wet"
    for clear, one, two in zip(views, soaked, transfer.transferred(views), strict=True):
        assert one.clear is two.clear is clear
        assert one.image.tobytes() == two.image.tobytes() and one.film.tobytes() == two.film.tobytes()
    for clear, made in zip(views, rainy(views, surroundings, wetness=0.0), strict=True):
        assert made.image.tobytes() == clear.image.tobytes() and made.film.max() == 0


def everything_in_one_view():
    """A shadow, a car with a tail lamp, a lamp on the wall, grass, leaves before the sky, and unmasked sky."""
    vehicles = np.zeros((128, 192))
    vehicles[66:84, 120:150] = 1
    eye = camera(ahead=(1.0, 0.0, -0.1), width=192, height=128)
    view = dry_view(shadow=0.7, texture=0.2, seen_from=eye, vehicles=vehicles)
    image, sky = view.image.copy(), view.sky.copy()
    for rows, columns, color in (
        ((66, 84), (120, 150), (0.2, 0.25, 0.4)), ((76, 78), (124, 127), (0.8, 0.15, 0.15)),
        ((36, 38), (60, 62), (1.0, 0.15, 0.1)), ((100, 128), (0, 70), (0.3, 0.45, 0.15)),
        ((2, 16), (20, 23), (0.2, 0.15, 0.1)),
    ):  # fmt: skip
        image[slice(*rows), slice(*columns)] = color
    sky[2:16, 20:23] = sky[:, 170:] = 0
    return replace(view, image=image, sky=sky)


GOLDEN = Path(__file__).with_name("golden.png")


def wet_pictures(surroundings):
    """Wet images of the view with its geometry and without, and the film of water, below each other."""
    view = everything_in_one_view()
    known, unknown = rainy([view], surroundings, wetness=0.8)[0], rainy([alone(view)], surroundings)[0]
    rows = [known.image, unknown.image, known.film[..., None].repeat(3, axis=2)]
    return np.rint(np.concatenate(rows) * 255).astype(np.uint8)


def test_the_pictures_are_the_golden_ones(surroundings):
    """To write them anew: `python -m tests.appearance.wet_look.test_wet_transfer`."""
    difference = np.abs(wet_pictures(surroundings).astype(int) - np.asarray(Image.open(GOLDEN)))
    assert np.mean(difference > 1) < 2e-4  # flips of rounding apart


def test_more_wetness_is_more_of_everything(views, surroundings, soaked):
    made = [rainy(views[:1], surroundings, wetness=w)[0] for w in (0.25, 0.5)] + soaked[:1]
    film, change = [float(each.film.sum()) for each in made], [np.abs(each.image - views[0].image) for each in made]
    sums = [float(each.sum()) for each in change]
    assert film == sorted(film) and 0 < film[0] < film[-1]
    assert sums == sorted(sums) and sums[0] > 0.05 * sums[-1]
    for less, more in itertools.pairwise(change):
        assert (more - less)[made[-1].film == 0].min() > -0.005


def test_views_agree_as_well_as_the_clear_ones(soaked):
    here, there = soaked
    found = correspondence(here.clear, there.clear)
    film = warped(np.ascontiguousarray(there.film[..., None]), found)[..., 0]
    counted = found.valid & (here.film < DRY) & (film < DRY)
    assert counted.mean() > 0.15
    clear, wet = (
        float(np.sqrt(np.mean((mine - warped(theirs, found))[counted] ** 2)))
        for mine, theirs in ((here.clear.image, there.clear.image), (here.image, there.image))
    )
    assert 0.001 < wet < ALLOWED * clear


def alone(view, **changes):
    """Return a view of which nothing but the picture and its sky is known."""
    nothing = np.zeros_like(view.depth)
    return replace(view, depth=nothing, normals=np.zeros_like(view.normals), known_share=0.0, **changes)


def test_pictures_alone_get_light_and_sky_and_no_water(views, surroundings, soaked):
    view = alone(views[0])
    (made,), (guessed,) = (rainy([each], surroundings) for each in (view, replace(views[0], known_share=0.3)))
    assert made.film.max() == guessed.film.max() == 0
    assert made.left_out and guessed.left_out and soaked[0].left_out == ""
    sky, below = view.sky > 0.99, np.flatnonzero(view.sky < 0.01)
    assert np.ptp(made.image[sky].mean(axis=0)) < 0.1  # it was blue
    before, after = (each.image.reshape(-1, 3)[below] for each in (view, made))
    assert (after.mean(), after.std()) < (before.mean(), before.std())
    # One curve for all pixels: nothing depends on where it is, so nothing can be taken for a road.
    order = np.random.default_rng(0).permutation(len(below))
    mixed = view.image.copy().reshape(-1, 3)
    mixed[below] = before[order]
    (shuffled,) = rainy([replace(view, image=mixed.reshape(view.image.shape))], surroundings)
    np.testing.assert_allclose(shuffled.image.reshape(-1, 3)[below], after[order], atol=2e-5)


def test_a_night_stays_a_night(surroundings):
    view = dry_view(texture=0.2)
    dark = alone(view, image=(0.06 * view.image).astype(np.float32), sky=np.zeros_like(view.sky))
    dusk = alone(view, image=(0.25 * view.image).astype(np.float32))
    night, evening = rainy([dark, dusk], surroundings)
    assert abs(float(night.image.mean() / dark.image.mean()) - 1) < 0.1
    assert evening.image[dusk.sky > 0.99].mean() < 0.45


def test_where_up_is_wrong_no_wall_is_a_ground(views, surroundings):
    wall_is_down = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1]])
    tipped = replace(
        views[0],
        camera=views[0].camera.moved(wall_is_down),
        normals=(views[0].normals @ wall_is_down[:3, :3].T).astype(np.float32),
    )
    assert surroundings.ground(views[0]) is not None
    assert surroundings.ground(tipped) is None


if __name__ == "__main__":
    Image.fromarray(wet_pictures(ImageEnvironment())).save(GOLDEN)
