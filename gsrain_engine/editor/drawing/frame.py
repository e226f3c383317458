"""A frame of the viewport: what is to be drawn, and what has come of it. Plain values."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import UInt8

from ...choices import RenderMode
from ...rain.frame import SkyLight
from ...rain.simulation import RainSimulation
from ...render.opengl.buffers import Harmonics
from ...render.relief import Relief
from ...render.renderer import Color
from ...render.sky_color import SkyColor
from ...render.view import RenderView
from ...scene.scene import RigCamera, Scene
from ...simulation.sensors import camera_of_width
from ..viewport.options import FULL_QUALITY, QualityLevel, Texture
from ..viewport.picking import SkyColorPick
from ..viewport_state import PendingScene

if TYPE_CHECKING:
    import moderngl


class SplitPane(NamedTuple):
    """Content of one pane of the viewport."""

    label: str
    scene: Scene
    rainfall: RainSimulation


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RenderInput:
    """Everything that a frame of the viewport depends on."""

    panes: tuple[SplitPane, ...]
    """One, or two from left to right; the last is the document's."""
    view: RenderView
    """Camera and time, in the resolution of the quality."""
    canvas_view: RenderView
    """The same in the size of the viewport, for what is drawn over the picture."""
    quality: QualityLevel = FULL_QUALITY
    is_moving: bool = False
    """True if the camera moves."""
    is_playing: bool = False
    scene: Scene
    """The document's, without drag previews and road users of roll-outs."""
    pending: PendingScene | None = None
    """Scene to prepare for its first frame."""
    sky: SkyColor
    """Last sample of the sky color."""
    samples_sky: bool = False
    """True if it has to be sampled again, because rain falls and the scene has changed."""
    overcast: float = 0.0
    """Share of the overcast sky of the displayed rain at the time of the view, 0..1."""
    picked: tuple[SkyColorPick, float, float] | None = None
    """Region whose color is to be measured, and wetness and share of the overcast sky of the document's rain."""
    mode: RenderMode = "splats"
    background: Color = (0.0, 0.0, 0.0)
    gain_ev: float = 0.0
    harmonics: Harmonics = "half"
    selection: bool = True
    """True to tint the selected Gaussians."""
    divider: float = 0.5
    """Boundary between two panes in a screenshot, as a share of the width."""
    screenshot: Path | None = None
    """Path at which to save the image."""
    thumbnail: bool = False
    """True to return the image, reduced or not, for the list of named views."""


class DrawnImage(NamedTuple):
    """An image that was drawn anew."""

    quality: QualityLevel
    frame_ms: float
    backend: str
    backend_reason: str
    """Times by which the back end was chosen."""
    statistics: Mapping[str, float]
    """Figures by name, in the order of the Statistics panel."""


@dataclass(slots=True, eq=False)
class DrawResult:
    """Images of a frame, and everything that its drawing has found."""

    frame: RenderInput | None = None
    """Input of the frame."""
    textures: "tuple[moderngl.Texture, ...]" = ()
    """One per pane, each with the whole image, first row on top."""
    reliefs: tuple[Relief | None, ...] = ()
    """One per texture, None for one that OpenGL has drawn."""
    drawn: DrawnImage | None = None
    """None if the last images were still valid."""
    is_compiling: bool = False
    """True if nothing can be drawn before kernels are compiled or loaded."""
    is_preparing: bool = False
    """True while kernels are compiled for the renderer of the next pictures, and OpenGL draws without rain."""
    kernels: int | None = None
    """Number of kernels that are compiled so far, of `kernel_names`; None if it is unknown, or none are missing."""
    is_settled: bool = False
    """True if no other back end takes over from the active one."""
    has_cuts: bool = False
    """True if pictures in motion can merge details instead of leaving Gaussians out."""
    is_catching_up: bool = False
    """True if the next frames continue unfinished work although nothing moves."""
    sky: SkyColor | None = None
    """A new sample of the sky color."""
    sky_is_exact: bool = False
    """True if the sky was sampled and needs no further sample."""
    picked_color: Color | None = None
    thumbnail: UInt8[np.ndarray, "h w 3"] | None = None
    """Image that was requested."""
    has_screenshot: bool = False
    """True if the requested screenshot was saved, or can't be saved."""
    is_pending_ready: bool = False
    """True if the pending scene can be displayed from the next frame on."""
    problems: list[str] = field(default_factory=list[str])
    """Errors that did not prevent an image, such as a screenshot that can't be saved."""

    @property
    def can_be_warped(self) -> bool:
        """True if there is a relief to warp images to a later moment."""
        return any(each is not None for each in self.reliefs)

    @property
    def has_news(self) -> bool:
        """True if anything but the present textures has been drawn, found, or is still to come."""
        found = (self.drawn, self.sky, self.picked_color, self.thumbnail)
        comes_soon = not (self.is_settled or self.is_preparing)
        is_open = self.is_catching_up or self.has_screenshot or self.is_pending_ready or comes_soon
        return is_open or bool(self.problems) or any(each is not None for each in found)


# Camera rig

_STEP_S = 0.05  # half the time over which the ego vehicle's velocity is averaged


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MosaicInput:
    """Small images of a rig's cameras at one time."""

    cameras: tuple[RigCamera, ...]
    width_px: int
    scene: Scene
    """With an ego vehicle, and without its body."""
    time_s: float
    is_playing: bool
    rainfall: RainSimulation
    sky: SkyLight
    background: Color
    gain_ev: float
    quality: QualityLevel

    def view_of(self, camera: RigCamera) -> RenderView:
        """View of a camera at the ego vehicle's pose, which it has at this time; without its lens, for any renderer."""
        before, pose, after = (self.scene.ego_to_world(self.time_s + step) for step in (-_STEP_S, 0.0, _STEP_S))
        assert pose is not None
        velocity = None if before is None or after is None else (after[:3, 3] - before[:3, 3]) / (2 * _STEP_S)
        pinhole = camera_of_width(camera, self.width_px).camera(pose).pinhole
        return RenderView(pinhole, self.time_s, velocity, camera.fx)

    def state_of(self, camera: RigCamera) -> Hashable:
        """Everything that the image of a camera depends on."""
        return (
            self.scene.appearance, self.rainfall, self.sky, self.time_s, self.width_px, camera, self.is_playing,
            self.gain_ev,
        )  # fmt: skip


class MosaicResult(NamedTuple):
    """Images by camera; `is_behind` is true if some are outdated."""

    pictures: dict[str, Texture]
    is_behind: bool
