"""Pictures for viewers on other screens, such as browsers: reduced while something changes, exact at rest."""

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import UInt8

from ...rain.settings import RainSettings
from ...rain.simulation import OVERCAST, RainSimulation
from ...render.cpu.renderer import CpuRenderer
from ...render.draw import draw
from ...render.frame_input import CameraMemory, FrameInput, Mount, Quality
from ...render.level_of_detail import LodCut, LodSubset, Thinning
from ...render.renderer import Renderer
from ...render.sky_color import SkyColor, sky_color
from ...render.view import RenderView
from ...render.view_reuse import ViewReuse
from ...scene.camera import Camera
from ...scene.lod_tree import MIN_GAUSSIANS, PIXEL
from ...scene.scene import Scene
from ..viewport.options import AdaptiveQuality, QualityLevel
from .live_trees import LiveCut, LiveTrees

_MIRROR_EVERY = 3  # pictures of reduced quality that share a mirror image
_FEWER = 1 / 8  # share of the Gaussians of parts without a tree, in pictures that merge details
_TARGET_MS = 100.0  # of a picture while something changes: connections add a delay that hides faster ones


class OutdatedPictureError(Exception):
    """Raised by a `checkpoint` to give up a picture whose view has changed meanwhile."""


@dataclass(slots=True)
class RemoteViewer:
    """View of one viewer, and the quality of its next picture. Uses no clock of its own."""

    view: RenderView
    """Camera in the size of the screen, time and motion."""
    budget: AdaptiveQuality = field(default_factory=lambda: AdaptiveQuality(target_ms=_TARGET_MS))
    reuse: ViewReuse = field(default_factory=lambda: ViewReuse(_MIRROR_EVERY))
    _seen: Hashable = None
    _seen_s: float = -math.inf
    _drawn: Hashable = None

    def due(self, version: Hashable, now_s: float) -> QualityLevel | None:
        """Return the quality of the picture that is due, None if the last one is up to date.

        `version` identifies scene and rain; `now_s` is any steady clock.
        """
        state = (version, self.fingerprint)
        is_first = self._seen is None
        moving, real_s = state != self._seen and not is_first, min(now_s - self._seen_s, 1e9)
        self._seen, self._seen_s = state, now_s
        quality = self.budget.observe(moving=moving, real_s=real_s)
        return None if (state, quality) == self._drawn else quality

    def finished(self, quality: QualityLevel, frame_ms: float) -> None:
        """Record that the picture last found due is finished, and the time that it took."""
        self._drawn = (self._seen, quality)
        self.budget.measured(quality, frame_ms)

    @property
    def fingerprint(self) -> Hashable:
        """Value that differs if the picture does, scene and rain aside."""
        camera, velocity = self.view.camera, self.view.velocity_m_s
        lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        moved = None if velocity is None else velocity.tobytes()
        return (camera.world_to_camera.tobytes(), lens, self.view.time_s, moved)


class RemotePictures:
    """Draws a scene in its rain for several viewers with one renderer. Not for several threads at a time."""

    def __init__(self, renderer: Renderer, scene: Scene, rain: RainSettings, place: Camera) -> None:
        """Begin with a scene and its rain; `place` is where the sky is sampled, for all viewers."""
        self._renderer, self._place = renderer, place
        self._scene, self._rainfall = scene, RainSimulation.start(rain)
        self._skies: dict[bool, SkyColor] = {}
        self._subsets: dict[float, LodSubset] = {}
        self._memory = CameraMemory()
        self.trees = LiveTrees()
        """Trees of the scene, for pictures by the processor."""

    def change(self, scene: Scene, rain: RainSettings) -> None:
        """Show another scene or rain from now on.

        Raises `ValueError` for rain that names a missing calibration, sensor or file of lamps.
        """
        if rain != self._rainfall.rain:
            self._rainfall, self._memory = RainSimulation.start(rain), CameraMemory()
        if scene is not self._scene:
            self._scene, self._skies, self._memory = scene, {}, CameraMemory()
            for subset in self._subsets.values():
                subset.forget_all_but(member.gaussians for member in scene.members)

    def picture(
        self,
        viewer: RemoteViewer,
        quality: QualityLevel,
        name: Hashable = "",
        checkpoint: Callable[[], None] = lambda: None,
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Draw the view of a viewer, over black, in the size that the quality says.

        At full quality it is the frame of `FrameSequence`. `name` identifies the viewer. `checkpoint` is called between
        stages of the drawing on the processor; what it raises ends it.
        """
        scene, rainfall, view = self._scene, self._rainfall, viewer.view
        whole = view.camera
        width, height = (max(1, round(quality.scale * side)) for side in (whole.width, whole.height))
        if (width, height) != (whole.width, whole.height):
            view = replace(view, camera=whole.resized(width, height), focal_px=float(np.sqrt(whole.fx * whole.fy)))
        sky = self._sky()
        if isinstance(self._renderer, CpuRenderer):
            self._renderer.checkpoint = checkpoint
            self.trees.follow([scene], at_once=True)
            viewer.budget.has_cuts = self.trees.cover([scene])
        thinning = self._thinning(quality)
        try:
            reflected = thinning.reflected if isinstance(thinning, LiveCut) else None
            reuse = None if quality.is_exact else viewer.reuse
            drawn = Quality(thinning=thinning, reflected=reflected, reuse=reuse)
            mount = Mount(self._memory, name)
            return draw(self._renderer, FrameInput.of(scene, rainfall, sky, view, drawn, mount=mount)).read_uint8()
        finally:
            if isinstance(self._renderer, CpuRenderer):
                self._renderer.checkpoint = lambda: None

    def _sky(self) -> SkyColor:
        if not self._rainfall.can_rain:
            return SkyColor(OVERCAST, found=False)
        dry = self._rainfall.is_never_overcast
        if dry not in self._skies:
            self._skies[dry] = sky_color(self._renderer, self._scene, self._place, dry=dry)
        return self._skies[dry]

    def _thinning(self, quality: QualityLevel) -> Thinning | None:
        """Choose the drawn Gaussians: of a large scene a cut, whose number falls with the square of its error."""
        share = _FEWER if quality.error_px > 0 else quality.gaussians
        subset = None if share == 1 else self._subsets.setdefault(share, LodSubset(share))
        if quality.error_px > 0 and subset is not None:
            return LiveCut(quality.error_px, self.trees, subset)
        if self._scene.gaussian_count >= MIN_GAUSSIANS and any(each.tree is not None for each in self._scene.members):
            return LodCut(PIXEL / math.sqrt(share), subset)
        return subset
