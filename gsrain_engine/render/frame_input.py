"""Frame input: all that one picture holds, decided once for everyone who asks for it."""

from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Protocol, runtime_checkable

import msgspec
import numpy as np
from jaxtyping import Float64

from ..choices import RenderMode
from ..rain.frame import RainFrame, SkyLight
from ..rain.simulation import RainSimulation
from ..scene.lamps import Lamp, LitLamps
from ..scene.lens_faces import wide_face
from ..scene.scene import Scene
from ..water.films import WaterDepth, WaterFilms
from ..water.glass import GlassHistory, PastMotion
from ..water.leveled_ground import LeveledView, leveled_view
from ..water.mirror import has_mirror, standing_water
from .bands import PictureBands
from .level_of_detail import Thinning
from .photograph import Photograph
from .still_scene import StillScene
from .view import RenderView, rain_camera
from .view_reuse import ViewReuse


@runtime_checkable
class Sky(Protocol):
    """Light of a sky that may close with rain: a `SkyColor`, or a `SkyLight`, which stays as it is."""

    def at(self, overcast: float) -> SkyLight:
        """Light at a share of the overcast sky, 0..1."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Quality:
    """Parts and fineness of a picture: a render mode, depth, and what makes it faster or larger."""

    mode: RenderMode = "splats"
    """Render modes other than "splats" have no rain."""
    with_depth: bool = False
    """Also draw depth, to which spray belongs: where `FrameInput.has_spray`, draw the scene's own depth when clear."""
    thinning: Thinning | None = None
    """Leaves out some of each part's Gaussians."""
    reflected: Thinning | None = None
    """The same in mirrors; None for that of the picture."""
    selection: bool = False
    """Tint selected Gaussians."""
    reuse: ViewReuse | None = None
    """Draws fewer mirrors, and views behind wet glass."""
    still: StillScene | None = None
    """Draws what stands still only once, by a renderer that can."""
    bands: PictureBands | None = None
    """Draw and read the picture in place of the renderer."""


@dataclass(slots=True, eq=False)
class CameraMemory:
    """Metered gains and water on glass, by camera: pictures reuse them, and would be the same without them."""

    gains: dict[Hashable, float] = field(default_factory=dict[Hashable, float])
    water: dict[Hashable, tuple[RainSimulation, GlassHistory]] = field(
        default_factory=dict[Hashable, tuple[RainSimulation, GlassHistory]]
    )


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """Camera over time, for the glass in front of it and its automatic exposure."""

    memory: CameraMemory = field(default_factory=CameraMemory)
    camera: Hashable = ""
    """Name in the memory."""
    past: PastMotion | None = None
    """Motion up to the picture; None for a camera that keeps the pose and the velocity of its view."""
    camera_to_vehicle: Float64[np.ndarray, "3 3"] | None = None
    """Orientation on a vehicle; None for a camera that looks ahead."""


class ReflectingGround(NamedTuple):
    """Wet ground that reflects a scene into a camera."""

    view: LeveledView
    depth: WaterDepth
    standing: tuple[float, float]


FALLING = frozenset({"streaks", "medium", "rings", "splashes", "spray"})
"""Passes of what falls: without them a picture has the light and the wet colors of rain only, behind dry glass."""


FILTERS = frozenset({"glass", "sensor"})
"""Passes that act on the whole picture, after all of its samples."""

_NOT_ORTHOGRAPHIC = FALLING | FILTERS  # an eye that is nowhere has no drops, air and glass before it


@dataclass(frozen=True, eq=False)
class FrameInput:
    """Input of one picture: a scene or a photograph, rain at a time, view, sky and quality. Made by `of`."""

    scene: Scene
    simulation: RainSimulation | None
    """Rain with its sensor and glass; None for a scene without any."""
    view: RenderView
    light: SkyLight
    """Light of the sky at the time of the picture."""
    quality: Quality = field(default_factory=Quality)
    is_clear: bool = False
    """True for the scene dry and as lit, behind the glass and the sensor of its rain."""
    without: frozenset[str] = frozenset()
    """Names of passes that are left out."""
    mount: Mount = field(default_factory=Mount)
    photograph: Photograph | None = None
    """Photograph that takes the place of the scene's Gaussians; `scene` is the world around it."""

    @classmethod
    def of(
        cls,
        scene: Scene,
        simulation: RainSimulation | None,
        sky: Sky,
        view: RenderView,
        quality: Quality | None = None,
        *,
        is_clear: bool = False,
        without: Iterable[str] = (),
        mount: Mount | None = None,
        photograph: Photograph | None = None,
    ) -> "FrameInput":
        """Decide the light of a picture: that of the sky at its time, closed as far as it rains.

        An orthographic camera has the light and the wet colors of the rain alone.
        """
        overcast = 0.0 if simulation is None or is_clear else simulation.overcast_at(view.time_s)
        left_out = _NOT_ORTHOGRAPHIC.union(without) if view.camera.is_orthographic else frozenset(without)
        return cls(
            scene, simulation, view, sky.at(overcast), quality or Quality(), is_clear, left_out, mount or Mount(),
            photograph,
        )  # fmt: skip

    def changed(
        self,
        *,
        view: RenderView | None = None,
        quality: Quality | None = None,
        without: Iterable[str] | None = None,
        is_clear: bool | None = None,
    ) -> "FrameInput":
        """Return another picture in the same light."""
        return FrameInput(
            self.scene, self.simulation, view or self.view, self.light, quality or self.quality,
            self.is_clear if is_clear is None else is_clear,
            self.without if without is None else frozenset(without), self.mount, self.photograph,
        )  # fmt: skip

    @property
    def time_s(self) -> float:
        return self.view.time_s

    @property
    def rainfall(self) -> RainSimulation | None:
        """Rain that acts on the scene; None if it is clear."""
        return None if self.is_clear else self.simulation

    @property
    def is_image(self) -> bool:
        """True for the image itself, false for other render modes."""
        return self.quality.mode == "splats"

    @cached_property
    def wetness(self) -> float:
        """Share of surfaces that is wet, 0..1."""
        return 0.0 if self.rainfall is None else self.rainfall.wetness_at(self.time_s)

    @cached_property
    def lamps(self) -> tuple[Lamp, ...]:
        """Lamps of the scene, or those that the rain names."""
        return tuple(self.scene.lamps if self.rainfall is None else self.rainfall.lamps_of(self.scene, self.time_s))

    @cached_property
    def lit_lamps(self) -> LitLamps | None:
        """Lamps that light drops, medium and water; None without any."""
        return self.scene.lamps_at(self.time_s, self.lamps) if self.rainfall is not None and self.lamps else None

    @cached_property
    def falling(self) -> RainFrame | None:
        """Drops and medium around the camera; None if nothing falls. Drops that are not drawn belong to the medium."""
        rainfall = self.rainfall
        if rainfall is None or not self.is_image or self.without >= FALLING:
            return None
        if rainfall.state_at(self.time_s).is_clear:
            return None
        camera = rain_camera(self.scene, rainfall, self.view)
        found = rainfall.frame(self.time_s, camera, self.light, self.lit_lamps)
        if "streaks" in self.without:
            found = replace(found, rain=msgspec.structs.replace(found.rain, streaks=False))
        if "medium" in self.without:
            clear_air = msgspec.structs.replace(found.rain, haze="none", visibility_m=None)
            found = replace(found, rain=clear_air, fog_extinction_per_m=0.0)
        return found

    @cached_property
    def reflecting_ground(self) -> ReflectingGround | None:
        """Ground that reflects the scene; None where no water does."""
        rainfall, water = self.rainfall, self.scene.water
        if rainfall is None or water is None or not rainfall.rain.mirror or not self.is_image or self.is_photograph:
            return None
        if "mirror" in self.without:
            return None
        depth = WaterFilms.of(rainfall, water).at(self.time_s)
        standing = standing_water(rainfall.frozen_at(self.time_s).rain, depth, self.wetness)
        camera = self.view.camera
        pinhole = camera.pinhole if camera.lens is None else wide_face(camera).of(camera)
        level = leveled_view(pinhole, water, self.scene.ground_m or 0.0)
        return ReflectingGround(level, depth, standing) if has_mirror(level, self.wetness, standing) else None

    @property
    def is_unchanged(self) -> bool:
        """True for a photograph in its own light with nothing in front of it."""
        if self.photograph is None or self.photograph.light.is_softened:
            return False
        glass = "none" if self.simulation is None else self.simulation.rain.glass
        return self.falling is None and glass == "none"

    @property
    def is_photograph(self) -> bool:
        return self.photograph is not None
