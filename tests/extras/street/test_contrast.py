"""The computed wet look beside the street's own: darker, stronger in color, with the contrasts of a diffuse sky."""

import cv2
import numpy as np
import pytest

from gsrain_engine.appearance.scene_views import PlacedCamera, scene_view
from gsrain_engine.appearance.wet_look.environment import SceneEnvironment
from gsrain_engine.appearance.wet_look.settings import WetSettings
from gsrain_engine.appearance.wet_look.translator import WetTransfer
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.scene.rig import rig_camera
from gsrain_extras.street.build import quads_to_gaussians

from .built_street import SHORT, street_of, surfaces_of

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@pytest.fixture(scope="module")
def images():
    """Clear image, that of the dry street under clouds, the computed wet one, and depth of two views below the sky."""
    surfaces, street = surfaces_of(SHORT), street_of(SHORT)
    clouds, renderer = street, CpuRenderer()
    for name, quads in surfaces.layers.items():
        clouds = clouds.with_member(f"layers/{name}", gaussians=quads_to_gaussians(quads, surfaces.light("overcast")))
    cameras = [
        PlacedCamera(name, rig_camera(street, "waymo_front3", name, at).resized(360, 240), at, name)
        for name, at in (("FRONT", 3.0), ("FRONT_LEFT", 1.0))
    ]
    found = []
    transfer = WetTransfer(WetSettings(), SceneEnvironment(street))
    for camera, wet in zip(cameras, transfer.transferred([scene_view(street, each) for each in cameras]), strict=True):
        renderer.draw(clouds.parts(camera.time_s), camera.camera)
        dry = renderer.read().rgba[..., :3]
        found.append((wet.clear.image, dry, wet.image, np.where(wet.clear.sky > 0.05, 0, wet.clear.depth)))
    return [np.stack(each) for each in zip(*found, strict=True)]


def weber(images, mask):
    shares = []
    for image, chosen in zip(images, mask, strict=True):
        gray = np.ascontiguousarray(image @ LUMINANCE)
        mean = cv2.blur(gray, (7, 7))
        deviation = np.sqrt(np.maximum(cv2.blur(gray * gray, (7, 7)) - mean**2, 0))
        shares.append((deviation / np.maximum(mean, 0.02))[chosen])
    return float(np.concatenate(shares).mean())


def saturation(colors):
    return float(((colors.max(axis=-1) - colors.min(axis=-1)) / np.maximum(colors.max(axis=-1), 0.02)).mean())


def test_near_objects_keep_the_contrast_of_a_diffuse_sky(images):
    _, dry, wet, depth = images
    near = (depth > 0) & (depth < 30)
    assert weber(wet, near) > 0.9 * weber(dry, near)


def test_nothing_is_lifted(images):
    clear, _, wet, depth = images
    solid = depth > 0
    darkest = [np.percentile(each[solid] @ LUMINANCE, 1) for each in (clear, wet)]
    assert darkest[1] <= darkest[0] + 1 / 255
    assert wet[solid].mean() < 0.9 * clear[solid].mean()


def test_leaves_and_brick_are_darker_and_stronger_in_color(images):
    clear, _, wet, depth = images
    red, green, blue = np.moveaxis(clear, -1, 0)
    for of in ((green > 1.15 * red) & (green > 1.3 * blue), (red > 1.2 * green) & (green > 1.1 * blue) & (red < 0.7)):
        chosen = of & (depth > 0) & (depth < 60)
        assert chosen.sum() > 250
        assert wet[chosen].mean() < clear[chosen].mean()
        assert saturation(wet[chosen]) > saturation(clear[chosen])
