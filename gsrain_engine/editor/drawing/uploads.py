"""Brings a scene's Gaussians to the GPU, some slices each frame."""

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
    """Uploads one scene at a time; what an earlier one had brought stays as long as there is room."""

    def __init__(self, renderer: SplatRenderer) -> None:
        self._renderer = renderer
        self._scene: Scene | None = None
        self._slices: Iterator[float] = iter(())

    def missing(self, scene: Scene) -> int:
        """How many Gaussians a frame would have to upload to draw a scene."""
        arrays = self._renderer.arrays
        return sum(arrays.missing(each.gaussians, each.wet_sh) for each in scene.members if each.visible)

    def go_on(self, scene: Scene, until_s: float) -> bool:
        """Upload what is missing of a scene until a moment of `time.perf_counter`; returns whether all is there."""
        if scene is not self._scene:
            self._scene, self._slices = scene, self._missing_slices(scene)
        while next(self._slices, None) is not None:
            if time.perf_counter() >= until_s:
                return False
        self._scene = None
        return True

    def give_up(self) -> None:
        """Let go of what has been uploaded for a scene that will not be shown."""
        self._scene, self._slices = None, iter(())
        self._renderer.arrays.release_awaited()

    def _missing_slices(self, scene: Scene) -> Iterator[float]:
        for member in scene.members:
            if member.visible:
                yield from self._renderer.upload(member.gaussians, wet_sh=member.wet_sh)


# § Looks at the sky again when the scene has changed, a picture a frame, so that no frame stalls over it.

logger = logging.getLogger("gsrain")

_QUICK = 60_000
"""So many Gaussians a first look draws; in larger scenes a second one draws all as soon as nothing moves."""


class SkyColorSampler:
    """What a scene's sky was when it was looked at last, and the look that is under way.

    The first look is done at once. Afterwards the last colour stands until the next look is through.
    """

    def __init__(self) -> None:
        self._camera_panel: Hashable = None
        """What the last look was at; none before the first."""
        self.is_exact = False
        """Whether the last look was at every Gaussian of the present scene."""
        self._sought: Hashable = None
        self._renderer: Renderer | None = None
        self._looking: Generator[None, None, SkyColor] | None = None
        self._at_all = False
        """Whether the look that is under way draws all Gaussians."""
        self.is_through = True
        """Whether no look is to come, but for an exact one while things move."""

    def forget(self) -> None:
        """Look at once next time: it is another scene's sky."""
        self._camera_panel = self._sought = self._looking = None

    def look(
        self, renderer: Renderer, scene: Scene, place: Camera, *, resting: bool, at_once: bool = False
    ) -> SkyColor | None:
        """Go on by one picture, or to the end `at_once`; returns the sky when a look is through."""
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
            return None  # while something is dragged, each frame has another scene
        while True:
            try:
                next(self._looking)
            except StopIteration as end:
                return self._accept(end.value, sought)
            if not to_the_end:
                return None

    def _accept(self, sky: SkyColor, seen: Hashable) -> SkyColor:
        if seen and not sky.found:  # a scene that is still to be opened shows nothing at all
            logger.info("The scene shows no sky: drops take the colour of an overcast one")
        self._camera_panel, self.is_exact, self._looking = seen, self._at_all, None
        return sky


def _what_shows_in(scene: Scene) -> Hashable:
    """Everything of a scene that its sky depends on; selecting changes none of it."""
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
