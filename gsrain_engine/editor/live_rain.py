"""The rain that the viewport displays: the simulation of the document's rain, its shelter map, and the sky color."""

from dataclasses import replace
from functools import partial

import msgspec

from ..rain.frame import SkyLight
from ..rain.keyframes import NO_KEYFRAMES, RainKeyframes
from ..rain.settings import RainSettings
from ..rain.shelter_map import ShelterMap, shelter_map_of
from ..rain.simulation import OVERCAST, RainSimulation
from ..render.sky_color import SkyColor
from ..scene.scene import Scene
from .background import Background, Task
from .document import Document, DocumentState
from .drive import RolloutPlayer
from .status import describe_error
from .viewport_state import ViewportState


class LiveRain:
    """Rain of the viewport. Follows the document; call `poll` once a frame."""

    def __init__(
        self, document: Document, viewport: ViewportState, rollouts: RolloutPlayer, background: Background
    ) -> None:
        self._document, self._viewport, self._rollouts = document, viewport, rollouts
        self.simulation = RainSimulation.start(document.rain, weather=document.keyframes)
        """The document's rain."""
        self._other = self.simulation
        self._background = background
        self._searched: Scene | None = None
        """Scene of the last search for roofs."""
        self._search: Task[ShelterMap | None] | None = None
        self.sky_color = SkyColor(OVERCAST, found=False)
        """Sky of the scene: one that was found stays until another is found."""
        self.sky_is_stale = True
        """True if the sky has to be sampled again, e.g. for another scene."""
        document.followers.append(self._follow)

    @property
    def displayed(self) -> RainSimulation:
        """Rain of the viewport: the document's, or that of the playing roll-out.

        It is without roofs until they are found, because finding them takes seconds.
        """
        has_roofs, rain = self._has_shelter_map, self._document.rain
        if (driven := self._rollouts.rainfall(roofs=has_roofs)) is not None:
            return driven
        if not rain.roofs or (has_roofs and self._viewport.drawn_preview is None):
            return self.simulation
        return replace(self.simulation, rain=msgspec.structs.replace(rain, roofs=False))

    @property
    def without_rain(self) -> RainSimulation:
        return self.of(self.displayed.rain.without_rain, NO_KEYFRAMES)

    def of(self, rain: RainSettings, keyframes: RainKeyframes) -> RainSimulation:
        """Simulation of other rain, such as that before the last edit; the last one is cached."""
        for each in (self.simulation, self._other):
            if each.rain == rain and each.weather is keyframes:
                return each
        self._other = RainSimulation.start(rain, weather=keyframes)
        return self._other

    @property
    def wetness_now(self) -> float:
        """Wetness (share of the wet colors) at the present time, 0..1."""
        return self.displayed.wetness_at(self._viewport.playback.clock.time_s)

    @property
    def overcast_now(self) -> float:
        """Share of the overcast sky at the present time, 0..1."""
        return self.displayed.overcast_at(self._viewport.playback.clock.time_s)

    @property
    def sky(self) -> SkyLight:
        """Light of the sky at the present time, for drops and medium."""
        return self.sky_color.at(self.overcast_now)

    @property
    def needs_sky(self) -> bool:
        """True if the sky has to be sampled for the displayed rain."""
        return self.sky_is_stale and self.displayed.can_rain

    def look_for_sky(self) -> None:
        """Let the sky be sampled for another scene; the last one stays until then, as not found there."""
        self.sky_color, self.sky_is_stale = self.sky_color._replace(found=False), True

    @property
    def is_searching_roofs(self) -> bool:
        return self._document.rain.roofs and not self._has_shelter_map

    @property
    def _has_shelter_map(self) -> bool:
        """True if the roofs of the scene are found: `shelter_map_of` caches the results of searches."""
        is_same = self._searched is not None and self._searched.geometry_key == self._document.scene.geometry_key
        return is_same and not self._is_searching

    def poll(self) -> None:
        """Search for roofs, one scene after another."""
        if self.is_searching_roofs and not self._is_searching:
            self._searched = scene = self._document.scene
            fail = partial(describe_error, "The roofs can't be found")
            self._search = self._background.start(lambda: shelter_map_of(scene), lambda _: None, fail)

    @property
    def _is_searching(self) -> bool:
        return self._search is not None and not self._search.future.done()

    def _follow(self, old: DocumentState, new: DocumentState) -> None:
        self.sky_is_stale = self.sky_is_stale or old.scene.geometry_key != new.scene.geometry_key
        if self.simulation.rain != new.rain or self.simulation.weather is not new.keyframes:
            time_s = self._viewport.playback.clock.time_s
            self.simulation = self.simulation.changed(new.rain, time_s, new.keyframes)
