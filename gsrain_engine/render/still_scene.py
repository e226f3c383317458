"""Still scene: what stands still before a still camera is drawn once, and rain and road users over it in each picture.

For pictures that must be fast rather than exact. The mirror of wet ground is drawn once as well; its rings are new in
each picture.
"""

import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from ..rain.frame import RainFrame
from ..scene.camera import Camera
from ..scene.gaussians import IdentityKey
from ..scene.scene import DrawItem, Scene
from ..water.leveled_ground import LeveledView
from ..water.mirror import Mirror, rows_of_ground
from ..water.rings import RingWaves
from .cpu.backdrop import Backdrop
from .cpu.renderer import CpuRenderer

_STEP_S = 0.1  # after which the pose of an actor is compared
_MOVED_M = 0.01  # by which a pose has to change to count as motion; also in entries of its rotation
_RESTS = 3.0  # times of a backdrop's drawing for which it stays, although keyframes of the rain have changed it
_VISIBLE_DIGITS = 2  # significant ones of wetness and medium: smaller changes can hardly be seen
_MIRROR_EVERY = 12  # pictures that share a mirror image although something in it has changed


class StillScene:
    """Backdrop and mirror image of one view, kept as long as nothing changes that they show.

    What has moved once counts as moving until the view or the scene changes.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self.built_ms = 0.0
        """Time that the last picture took for what later ones share."""
        self._key: Hashable = None
        self._air: Hashable = None
        self._rests_until = 0.0
        self._backdrop: Backdrop | None = None
        self._view: Hashable = None
        self._movers = set[IdentityKey]()
        self._poses: dict[IdentityKey, Float64[np.ndarray, "4 4"]] = {}
        self._mirror: Mirror | None = None
        self._mirror_key: Hashable = None
        self._mirror_state: Hashable = None
        self._mirror_left = 0

    def split(
        self, scene: Scene, items: Sequence[DrawItem], camera: Camera, time_s: float
    ) -> tuple[list[DrawItem], list[DrawItem]]:
        """Items that stand still, and those that move, at the begin of a picture."""
        self.built_ms = 0.0
        if (view := (IdentityKey(scene), *_view_of(camera))) != self._view:
            self._view = view
            self._movers.clear()
            self._poses.clear()
        for actor in scene.actors:
            now, later = (actor.pose_at(at) for at in (time_s, time_s + _STEP_S))
            if now is None or later is None or np.abs(later - now).max() > _MOVED_M * _STEP_S:
                self._movers.add(IdentityKey(actor.gaussians))
        for item in items:
            own = IdentityKey(item.gaussians)
            if np.abs(item.to_world - self._poses.setdefault(own, item.to_world)).max() > _MOVED_M:
                self._movers.add(own)
        moves = [IdentityKey(item.gaussians) in self._movers for item in items]
        pairs = list(zip(items, moves, strict=True))
        return [item for item, moving in pairs if not moving], [item for item, moving in pairs if moving]

    def draw(
        self,
        renderer: CpuRenderer,
        fixed: Sequence[DrawItem],
        fixed_parts: Callable[[], Sequence[DrawItem]],
        moving: Sequence[DrawItem],
        camera: Camera,
        rain: RainFrame | None,
        mirror: Mirror | None,
        weather: Hashable = None,
    ) -> None:
        """Draw moving parts and rain over the backdrop of the fixed items.

        `fixed_parts` returns the parts of those; it is called only if the backdrop is outdated. `weather` is the
        identity of rain that changes by its keyframes, None for rain that is the same at any time: the wetness and the
        medium of the backdrop may lag a little behind it, so that drawing backdrops takes a quarter of the time.
        """
        items = tuple((IdentityKey(item.gaussians), item.selected is None) for item in fixed)
        key = items, self._view, _place_of(rain), mirror is None, weather if weather is not None else _rain_of(rain)
        wetness = [item.wetness for item in fixed]
        air = _air_of(rain, wetness, digits=None if weather is None else _VISIBLE_DIGITS)
        is_due = air != self._air and (weather is None or self._clock() >= self._rests_until)
        if self._backdrop is None or key != self._key or is_due:
            started = self._clock()
            self._backdrop, self._key, self._air = renderer.draw_backdrop(fixed_parts(), camera, rain), key, air
            took_s = self._clock() - started
            self._rests_until = started + (1 + _RESTS) * took_s
            self.built_ms += 1000 * took_s
        renderer.draw_over(self._backdrop, moving, camera, rain, mirror)

    def mirror(
        self,
        view: LeveledView,
        moving: Sequence[DrawItem],
        state: Hashable,
        draw: Callable[[], Mirror],
        waves: RingWaves | None,
    ) -> Mirror:
        """Return the last mirror image with new rings, or draw one: for another view, and if it has changed for long.

        `state` is everything else that it depends on.
        """
        key = self._view, rows_of_ground(view.camera), waves is None
        changing = state, tuple((IdentityKey(item.gaussians), item.to_world.tobytes()) for item in moving)
        is_old = self._mirror_left <= 0 and changing != self._mirror_state
        if self._mirror is None or key != self._mirror_key or is_old:
            started = self._clock()
            self._mirror, self._mirror_left = draw(), _MIRROR_EVERY
            self._mirror_key, self._mirror_state = key, changing
            self.built_ms += 0.0 if is_old else 1000 * (self._clock() - started)
        self._mirror_left -= 1
        rings = self._mirror.rings
        if waves is None or rings is None:
            return self._mirror
        return replace(self._mirror, rings=rings._replace(on_films=waves.on_films, on_standing=waves.on_standing))


def _view_of(camera: Camera) -> tuple[Hashable, ...]:
    c = camera
    return c.world_to_camera.tobytes(), c.width, c.height, c.fx, c.fy, c.cx, c.cy


def _rain_of(rain: RainFrame | None) -> Hashable:
    return None if rain is None else rain.rain


def _place_of(rain: RainFrame | None) -> Hashable:
    """Place of the medium; None without one."""
    return None if rain is None else (rain.view.anchor_to_world.tobytes(), rain.view.floor_m)


def _air_of(rain: RainFrame | None, wetness: Sequence[float], digits: int | None) -> Hashable:
    """Return the wetness and the medium of a view, in some significant digits (None: all)."""
    values = [*wetness]
    if rain is not None:
        values += [rain.extinction_per_m, rain.fog_extinction_per_m, rain.count, *rain.airlight.tolist()]
    return tuple(values if digits is None else (float(f"{each:.{digits}g}") for each in values))
