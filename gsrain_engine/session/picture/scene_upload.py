"""Brings a scene's Gaussians to the GPU, some slices each frame."""

import time
from collections.abc import Iterator

from gsrain_engine.render.splat_renderer import SplatRenderer
from gsrain_engine.scene.scene import Scene


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
