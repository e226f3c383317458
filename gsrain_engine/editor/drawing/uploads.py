"""Uploads of Gaussians to the GPU in slices, and sampling of the sky color over several frames."""

import logging
import time
from collections.abc import Generator, Hashable, Iterator

from ...render.draw import LodSubset
from ...render.opengl.renderer import SplatRenderer
from ...render.renderer import Renderer
from ...render.sky_color import SkyColor, sample_sky
from ...scene.camera import Camera
from ...scene.gaussians import IdentityKey
from ...scene.scene import Scene


class SceneUpload:
    """Uploads one scene at a time; earlier scenes stay on the GPU as long as there is room."""

    def __init__(self, renderer: SplatRenderer) -> None:
        self._renderer = renderer
        self._scene: Scene | None = None
        self._slices: Iterator[float] = iter(())

    def missing(self, scene: Scene) -> int:
        """Number of Gaussians a frame would have to upload to draw a scene."""
        arrays = self._renderer.arrays
        return sum(arrays.missing(each.gaussians, each.wet_sh) for each in scene.members if each.visible)

    def go_on(self, scene: Scene, until_s: float) -> bool:
        """Upload missing slices of a scene until a time of `time.perf_counter`; return whether all are uploaded."""
        if scene is not self._scene:
            self._scene, self._slices = scene, self._missing_slices(scene)
        while next(self._slices, None) is not None:
            if time.perf_counter() >= until_s:
                return False
        self._scene = None
        return True

    def give_up(self) -> None:
        """Release the slices uploaded for a scene that will not be shown."""
        self._scene, self._slices = None, iter(())
        self._renderer.arrays.release_awaited()

    def _missing_slices(self, scene: Scene) -> Iterator[float]:
        for member in scene.members:
            if member.visible:
                yield from self._renderer.arrays.upload(member.gaussians, wet_sh=member.wet_sh)


# Sky color
# Sampled again when the scene has changed, one image a frame, so that no frame stalls.

logger = logging.getLogger("gsrain")
_QUICK = 60_000
"""Number of Gaussians that a first sample draws; larger scenes get a second, full one as soon as nothing moves."""


class SkyColorSampler:
    """Sky color of the last sample, and the sample in progress.

    The first sample finishes at once. Later ones keep the last color until they are done.
    """

    def __init__(self) -> None:
        self._camera_panel: Hashable = None
        """Scene state of the last sample; None before the first."""
        self.is_exact = False
        """True if the last sample included every Gaussian of the present scene."""
        self._sought: Hashable = None
        self._renderer: Renderer | None = None
        self._looking: Generator[None, None, SkyColor] | None = None
        self._at_all = False
        """True if the sample in progress draws all Gaussians."""
        self.is_through = True
        """True if no sample is pending, except for an exact one while things move."""

    def forget(self) -> None:
        """Forget the last sample, so that the next one finishes at once, e.g. for another scene."""
        self._camera_panel = self._sought = self._looking = None

    def look(
        self, renderer: Renderer, scene: Scene, place: Camera, *, resting: bool, at_once: bool = False
    ) -> SkyColor | None:
        """Continue by one image, or to the end if `at_once`; return the sky color when a sample is complete."""
        sought = _what_shows_in(scene)
        is_new, stays = sought != self._camera_panel, sought == self._sought and renderer is self._renderer
        self._sought, self._renderer = sought, renderer
        self.is_exact &= not is_new
        self.is_through = not is_new and (self.is_exact or not (resting or at_once))
        if self.is_through:
            self._looking = None
            return None
        count = sum(len(each.gaussians) for each in scene.members if each.visible)
        at_all = count <= _QUICK or at_once or (resting and not is_new)
        if self._looking is None or not stays or at_all != self._at_all:
            thinning = None if at_all else LodSubset(_QUICK / count)
            self._looking, self._at_all = sample_sky(renderer, scene, place, thinning=thinning), at_all
        to_the_end = at_once or self._camera_panel is None
        if not (stays or to_the_end):
            return None  # during a drag each frame has another scene
        while True:
            try:
                next(self._looking)
            except StopIteration as end:
                return self._accept(end.value, sought)
            if not to_the_end:
                return None

    def _accept(self, sky: SkyColor, seen: Hashable) -> SkyColor:
        if seen and not sky.found:  # a scene that is still loading shows nothing
            logger.info("The scene shows no sky: drops take the colour of an overcast one")
        self._camera_panel, self.is_exact, self._looking = seen, self._at_all, None
        return sky


def _what_shows_in(scene: Scene) -> Hashable:
    """Everything in a scene that its sky color depends on; the selection does not."""
    return tuple(
        (
            part.gaussians,
            IdentityKey(part.wet_sh),
            part.to_world.tobytes(),
            part.left_out,
            part.opacity,
            colors,
            each.key,
        )
        for each in scene.members
        if each.visible and (part := scene.part(each)) is not None
        for colors in [None if part.colors is None else part.colors.tobytes()]
    )
