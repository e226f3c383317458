"""Looks at the sky again when the scene has changed, a picture a frame, so that no frame stalls over it."""

import logging
from collections.abc import Generator, Hashable

from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.sky_color import Sky, looking_at_sky
from gsrain_engine.render.thinning import Thinning
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.identity import Identity
from gsrain_engine.scene.scene import Scene

logger = logging.getLogger("gsrain")

_QUICK = 60_000
"""So many Gaussians a first look draws; in larger scenes a second one draws all as soon as nothing moves."""


class SkyWatch:
    """What a scene's sky was when it was looked at last, and the look that is under way.

    The first look is done at once. Afterwards the last colour stands until the next look is through.
    """

    def __init__(self) -> None:
        self._seen: Hashable = None
        """What the last look was at; none before the first."""
        self.is_exact = False
        """Whether the last look was at every Gaussian of the present scene."""
        self._sought: Hashable = None
        self._renderer: Renderer | None = None
        self._looking: Generator[None, None, Sky] | None = None
        self._at_all = False
        """Whether the look that is under way draws all Gaussians."""
        self.is_through = True
        """Whether no look is to come, but for an exact one while things move."""

    def forget(self) -> None:
        """Look at once next time: it is another scene's sky."""
        self._seen = self._sought = self._looking = None

    def look(
        self, renderer: Renderer, scene: Scene, place: Camera, *, resting: bool, at_once: bool = False
    ) -> Sky | None:
        """Go on by one picture, or to the end `at_once`; returns the sky when a look is through."""
        sought = _what_shows_in(scene)
        is_new, stays = sought != self._seen, sought == self._sought and renderer is self._renderer
        self._sought, self._renderer = sought, renderer
        self.is_exact &= not is_new
        self.is_through = not is_new and (self.is_exact or not (resting or at_once))
        if self.is_through:
            self._looking = None
            return None
        count = sum(len(each.gaussians) for each in scene.members if each.visible)
        at_all = count <= _QUICK or at_once or (resting and not is_new)
        if self._looking is None or not stays or at_all != self._at_all:
            thinning = None if at_all else Thinning(_QUICK / count)
            self._looking, self._at_all = looking_at_sky(renderer, scene, place, thinning=thinning), at_all
        to_the_end = at_once or self._seen is None
        if not (stays or to_the_end):
            return None  # while something is dragged, each frame has another scene
        while True:
            try:
                next(self._looking)
            except StopIteration as end:
                return self._taken(end.value, sought)
            if not to_the_end:
                return None

    def _taken(self, sky: Sky, seen: Hashable) -> Sky:
        if seen and not sky.found:  # a scene that is still to be opened shows nothing at all
            logger.info("The scene shows no sky: drops take the colour of an overcast one")
        self._seen, self.is_exact, self._looking = seen, self._at_all, None
        return sky


def _what_shows_in(scene: Scene) -> Hashable:
    """Everything of a scene that its sky depends on; selecting changes none of it."""
    return tuple(
        (part.gaussians, Identity(part.wet_sh), part.to_world.tobytes(), part.left_out, part.opacity, colors, each.key)
        for each in scene.members
        if each.visible and (part := scene.part(each)) is not None
        for colors in [None if part.colors is None else part.colors.tobytes()]
    )
