"""The overcast sky: light by world direction, and how it takes the place of the clear one."""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, Float32
from msgspec.structs import replace as replace_fields

from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.appearance.normals.from_depth import view_rays
from gsrain_engine.scene.srgb import srgb_to_linear

from .noise import SmoothNoise
from .settings import WetSettings
from .smoothstep import smoothstep

Image = Float32[np.ndarray, "h w 3"]

HORIZON_TO_ZENITH = 0.86
"""Display brightness overhead over that at the horizon. CIE's overcast sky (ISO 15469) is brighter overhead, but
rain-laden air is brighter where one looks through more of it."""
TINT = np.array([-0.045, 0.0, 0.04], np.float32)
"""Display colour of cloud over grey: 7000 K seen by a camera balanced for 5500 K, kept milder than the ratio."""

_CLOUD_HEIGHT_PERIODS = 5.0
"""Period of the cloud deck in its own height above the eye."""
_CLOUD_CONTRAST = 0.06
_FLAT = 0.12
"""Added to the rise of a direction, so that clouds don't shrink without end towards the horizon."""

_LOCAL_SHARE = 0.012
"""Size over which the clear sky's colour is averaged, as a share of the picture's width."""
_LEAST_COVER = 0.05
_LIKE, _AMIDST = (0.04, 0.12), (0.3, 0.6)
"""Difference (display) up to which a colour is the sky's, and from which it is not; the same for sky around it."""
_BESIDE, _ROUNDS, _LEAST_GROWTH = (0.01, 0.06), 10, 2e-4
"""The same beside the sky; how often it may grow there, and the share of what is open that it must gain each time."""


def overcast_sky(directions: Float[np.ndarray, "h w 3"], settings: WetSettings) -> Image:
    """Light of the cloud deck by unit world direction (z up), linear. Below the horizon it is that of the horizon."""
    rise = np.clip(directions[..., 2], 0, 1).astype(np.float32)
    over = _CLOUD_HEIGHT_PERIODS * (rise + _FLAT)
    clouds = SmoothNoise(settings.seed).at(directions[..., 0] / over, directions[..., 1] / over)
    grey = settings.sky_brightness * (1 - (1 - HORIZON_TO_ZENITH) * rise**0.7)
    grey *= 1 + settings.clouds * _CLOUD_CONTRAST * clouds * np.minimum(1, 4 * rise + 0.3)
    display = np.minimum(grey[..., None] + settings.coolness * TINT, 1)
    return srgb_to_linear(display.astype(np.float32)).astype(np.float32)


def with_own_sky(view: ClearView) -> ClearView:
    """Count as sky what has its colour and stands in its midst, or beside it at a distance that is not known.

    Scenes keep scraps of sky before the sky, and masks of pictures end where twigs begin. Where distances are not
    known, only what stands in its midst counts: hills and walls beside a sky may have its colour.
    """
    rising = view_rays(view.camera)[..., 2] > 0
    is_open = (view.depth <= 0) & rising & view.has_surfaces
    share = view.sky
    for _ in range(_ROUNDS):
        behind, around = _local_sky(view.image, share)
        like = 1 - smoothstep(*_LIKE, np.abs(view.image - behind).max(axis=-1))
        near = np.where(is_open, smoothstep(*_BESIDE, around), smoothstep(*_AMIDST, around))
        grown = np.maximum(share, like * near * rising).astype(np.float32)
        added, share = np.mean((grown - share)[is_open]) if is_open.any() else 0.0, grown
        if added < _LEAST_GROWTH:
            break
    return replace(view, sky=share)


def like_own_sky(view: ClearView, settings: WetSettings, daylight: float) -> WetSettings:
    """Return settings whose cloud is, but for the share of daylight, no brighter than the clear sky of a picture.

    Where the light of a place is not known its own sky tells it: over a street at dusk no cloud is white.
    """
    sky = view.sky > 0.9
    if not sky.any():
        return settings
    own = float(np.median(view.image[sky].mean(axis=-1)))
    brightness = own + daylight * (settings.sky_brightness - own)
    return replace_fields(settings, sky_brightness=float(np.clip(brightness, 0.3, settings.sky_brightness)))


def without_sky(view: ClearView) -> Image:
    """What stands before the sky, display colour: pixels that are partly sky are unmixed from its colour around them.

    Renderers and cameras alike mix edges: picture = sky share * sky + rest * surface, solved for the surface.
    """
    share = view.sky[..., None]
    behind, _ = _local_sky(view.image, view.sky)
    rest = np.maximum(1 - share, _LEAST_COVER)
    return np.clip((view.image - share * behind) / rest, 0, 1).astype(np.float32)


def _local_sky(image: Image, share: Float32[np.ndarray, "h w"]) -> tuple[Image, Float32[np.ndarray, "h w"]]:
    """Colour of the clear sky around each pixel (display), and share of pixels there that show nothing else."""
    weight = (share > 0.9).astype(np.float32)
    sigma = max(1.0, _LOCAL_SHARE * share.shape[1])
    around = cv2.GaussianBlur(weight, (0, 0), sigma)
    colors = cv2.GaussianBlur(image * weight[..., None], (0, 0), sigma)
    return (colors / (around[..., None] + 1e-6)).astype(np.float32), around
