"""Rain simulation: from settings, time and camera to drops and haze."""

from dataclasses import dataclass, field
from functools import cache, cached_property

import msgspec
import numpy as np
from jaxtyping import Float64

from ..scene.camera import Camera
from ..scene.geometry import linear_to_srgb, srgb_to_linear
from ..scene.lamp_choice import OWN_LAMPS, LampChoice, lamp_choice
from ..scene.lamps import Lamp, LitLamps
from ..scene.rolling_shutter import Readout, readout_of
from ..scene.scene import Scene
from ..scene.sensor import DEFAULT_SENSOR, Sensor, ThinLens, load_sensor
from .air import Wind
from .calibration import Calibration, load_calibration
from .drop_field import DropCulling, DropPhases, drop_phases
from .drop_motion import DropMotion, KeyframedDropMotion, wind_of
from .fog import fog_overcast
from .frame import RainCamera, RainFrame, SkyLight
from .keyframes import NO_KEYFRAMES, RainKeyframes
from .properties import RainProperties, fall_speed, rain_properties
from .settings import RainSettings
from .streaks import MAX_STRETCH, STREAK_REACH, ShutterModel, camera_slopes, visible_distance_m
from .wetness import WetnessCurve, overcast, wetness

OVERCAST = SkyLight.uniform((0.78, 0.79, 0.80))
"""Light in scenes without a sky."""


@dataclass(frozen=True, eq=False)
class RainSimulation:
    """Rain with its precomputed quantities. Immutable: `changed` returns a new one.

    With keyframes, properties, sizes and speeds depend on time: `frozen_at` returns them for one time.
    """

    rain: RainSettings
    calibration: Calibration
    state: RainProperties
    """Properties of the rain without keyframes; see `state_at`."""
    diameters_mm: Float64[np.ndarray, " classes"]
    motion: DropMotion
    sensor: Sensor
    """Sensor of the cameras: its lens and readout act on drops, its shutter and the rest only if the rain names it."""
    weather: RainKeyframes = NO_KEYFRAMES
    lamps: LampChoice = OWN_LAMPS
    """Lamps that the rain names, in place of a scene's own."""
    _keyed_motion: KeyframedDropMotion | None = None
    _frozen: "dict[float, RainSimulation]" = field(default_factory=dict, init=False)
    """Cache of the latest `frozen_at`."""

    @classmethod
    def start(
        cls, rain: RainSettings, calibration: Calibration | None = None, weather: RainKeyframes | None = None
    ) -> "RainSimulation":
        """Begin a rain whose drops are a function of (seed, t) alone."""
        calibration, weather = calibration or load_calibration(rain.calibration), weather or NO_KEYFRAMES
        state, diameters, wind, speeds = _drops(rain, calibration)
        keyed = KeyframedDropMotion.of(rain, weather, calibration) if weather.keys else None
        sensor = load_sensor(rain.sensor or DEFAULT_SENSOR)
        lamps = lamp_choice(rain.lamps)
        return cls(rain, calibration, state, diameters, DropMotion(wind, speeds), sensor, weather, lamps, keyed)

    def changed(self, rain: RainSettings, time_s: float, weather: RainKeyframes | None = None) -> "RainSimulation":
        """Change the rain, and optionally its keyframes; drops continue from their current positions."""
        is_same = rain.calibration == self.rain.calibration
        calibration = self.calibration if is_same else load_calibration(rain.calibration)
        weather = self.weather if weather is None else weather
        state, diameters, wind, speeds = _drops(rain, calibration)
        motion, keyed = self.frozen_at(time_s).motion.changed(time_s, wind, speeds), None
        if weather.keys and weather is self.weather and all(getattr(rain, f) == getattr(self.rain, f) for f in _MOVING):
            keyed = self._keyed_motion
        elif weather.keys:
            keyed = KeyframedDropMotion.of(rain, weather, calibration).going_on_from(motion)
        sensor = self.sensor if rain.sensor == self.rain.sensor else load_sensor(rain.sensor or DEFAULT_SENSOR)
        lamps = self.lamps if rain.lamps == self.rain.lamps else lamp_choice(rain.lamps)
        return RainSimulation(rain, calibration, state, diameters, motion, sensor, weather, lamps, keyed)

    def frozen_at(self, time_s: float) -> "RainSimulation":
        """Return the rain at a time, without keyframes; valid for that time only."""
        keyed = self._keyed_motion
        if keyed is None:
            return self
        frozen = self._frozen.get(time_s)
        if frozen is None:
            rain = self.weather.rain_at(self.rain, time_s)
            state = rain_properties(rain, self.calibration)
            frozen = RainSimulation(
                rain,
                self.calibration,
                state,
                keyed.diameters_mm(time_s),
                keyed.motion(time_s),
                self.sensor,
                lamps=self.lamps,
            )
            self._frozen.clear()
            self._frozen[time_s] = frozen  # another thread may clear it at once
        return frozen

    def state_at(self, time_s: float) -> RainProperties:
        return self.frozen_at(time_s).state

    def wetness_at(self, time_s: float) -> float:
        """Share of surfaces that is wet at a time, 0..1: the set value, or derived from the intensity."""
        if (keyed := self.weather.curves.get("wetness")) is not None:
            return float(keyed.at(time_s)[0])
        if self.rain.wetness is not None:
            return self.rain.wetness
        return self._wetness.at(time_s) if isinstance(self._wetness, WetnessCurve) else self._wetness

    def soaked_share_at(self, time_s: float) -> float:
        """Share of a scene's soaked colors at a time, 0..1: the wetness, and in thick fog its share of clouds.

        Only soaked colors are in the light of clouds, without the sun's shadows; in fog, surfaces are damp as well.
        """
        wet = self.wetness_at(time_s)
        fog = fog_overcast(self.frozen_at(time_s).rain.visibility_m)
        return wet if self.has_own_wetness else max(wet, fog)

    def overcast_at(self, time_s: float) -> float:
        """Share of the overcast sky at a time, 0..1: closed in rain and fog, and as long as anything is wet.

        With a wetness of 0 the scene stays as lit, at any intensity.
        """
        wet = self.wetness_at(time_s)
        if self.is_as_lit:
            return wet
        now = self.frozen_at(time_s).rain
        return max(wet, overcast(now.intensity_mm_h), fog_overcast(now.visibility_m))

    @cached_property
    def _wetness(self) -> WetnessCurve | float:
        intensity = self.weather.curves.get("intensity_mm_h")
        steady = self.rain.intensity_mm_h
        return wetness(steady) if intensity is None else WetnessCurve(intensity, self.rain.drying_s)

    @property
    def can_rain(self) -> bool:
        """True if there is rain or fog at any time."""
        return self.weather.heaviest_mm_h(self.rain) > 0 or self.rain.visibility_m is not None

    @property
    def is_never_overcast(self) -> bool:
        """True if `overcast_at` is 0 at any time."""
        return self.is_as_lit or (not self.has_own_wetness and not self.can_rain)

    @property
    def is_dry(self) -> bool:
        """True if there is neither rain nor fog nor anything wet at any time."""
        return not self.can_rain and (self.is_as_lit or not self.has_own_wetness)

    @property
    def has_own_wetness(self) -> bool:
        """True if the wetness is set, or has keyframes, and does not follow from the intensity."""
        return self.rain.wetness is not None or self.weather.is_keyed("wetness")

    @property
    def is_as_lit(self) -> bool:
        """True if the wetness is 0 at any time, by choice."""
        return self.rain.wetness == 0 and not self.weather.is_keyed("wetness")

    def lamps_of(self, scene: Scene, time_s: float) -> tuple[Lamp, ...]:
        """Lamps of a scene at a time, with the rain's `lamp_gain`."""
        lamps, gain = self.lamps.of(scene), self.frozen_at(time_s).rain.lamp_gain
        if gain == 1:
            return lamps
        return tuple(msgspec.structs.replace(each, intensity_m2=gain * each.intensity_m2) for each in lamps)

    def exposure_s(self, camera: Camera) -> float:
        """Shutter time: the rain's own, else that of a sensor which the rain names, else the camera's."""
        named = None if self.rain.sensor is None else self.sensor.shutter_s
        return self.rain.exposure_s or named or camera.exposure_s

    def lens(self, camera: Camera) -> ThinLens:
        """Lens of a camera: the sensor's, with what the rain sets in its place."""
        aperture_mm, focus_m = self.rain.aperture_mm, self.rain.focus_distance_m
        own = self.sensor.lens(camera) if aperture_mm is None else ThinLens(1e-3 * aperture_mm)
        return own if focus_m is None else own._replace(focus_m=focus_m)

    def readout(self, camera: Camera) -> Readout:
        """Rolling shutter of a camera for drops: its own, else the sensor's."""
        rolling = camera.rolling
        if rolling is None:
            return self.sensor.readout(camera)
        return readout_of(camera, rolling.readout_s, rolling.direction)

    @property
    def picture_sensor(self) -> Sensor | None:
        """Sensor that acts on the picture; None without one, or if the rain does not name it."""
        return self.sensor if self.rain.sensor is not None and self.sensor.changes_picture else None

    def frame(
        self,
        time_s: float,
        view: RainCamera,
        sky: SkyLight = OVERCAST,
        lamps: LitLamps | None = None,
    ) -> RainFrame:
        """Place drops and haze around a camera at a time.

        `sky` gives drops and medium their colors, unless the settings have one; `lamps` light drops and medium.
        """
        now = self.frozen_at(time_s)
        rain, motion, camera = now.rain, now.motion, view.camera
        turn, size = view.anchor_to_world[:3, :3], np.array(rain.streak_region.size_m)
        center = turn @ np.array(rain.streak_region.center_m) + view.anchor_to_world[:3, 3]
        if rain.is_paper:  # the region is the cell: drops stay in the ego's frame, fall straight, re-enter at the top
            period, axes = size, turn
        else:  # world axes; a horizontal period of the region's diagonal covers the region at any yaw
            period, axes = np.array([*np.full(2, np.hypot(size[0], size[1])), size[2]]), np.eye(3)
        focal_px = view.focal_px or float(np.sqrt(camera.fx * camera.fy))
        shutter = ShutterModel(
            camera, view.velocity_m_s, now.exposure_s(camera) * view.exposure_share, focal_px, now.lens(camera),
            self.readout(camera),
        )  # fmt: skip
        reach = float(np.hypot(period[0], period[1])) / 2

        @cache
        def find_drops() -> tuple[DropPhases, DropCulling]:
            if rain.is_paper:
                where = drop_phases(motion.without_drift(), time_s, np.zeros(3), period)
            else:
                lower_m = float(view.anchor_to_world[2, 3]) + rain.streak_region.minimum_m[2]
                where = drop_phases(motion, time_s, center, period, lower_m if view.ground_m is None else view.ground_m)
            return where, now._culling(turn, axes, center, shutter, where.air.fastest_m_s)

        return RainFrame(
            rain=rain,
            time_s=time_s,
            view=view,
            color=np.array(rain.drop_color or sky.drops),
            airlight=np.array(rain.drop_color or sky.airlight),
            haze_count=now.state.haze_gaussians,
            extinction_per_m=now.state.extinction_per_m,
            fog_extinction_per_m=now.state.fog_extinction_per_m,
            count=round(now.state.density_m3 * float(np.prod(period))),
            find_drops=find_drops,
            period_m=period,
            axes=axes,
            center_m=center,
            diameters_mm=now.diameters_mm,
            fall_speed_m_s=motion.fall_speed_m_s,
            shutter=shutter,
            roofs=None if view.roofs is None else view.roofs.around(float(center[0]), float(center[1]), reach),
            lamps=lamps,
        )

    def _culling(
        self,
        turn: Float64[np.ndarray, "3 3"],
        axes: Float64[np.ndarray, "3 3"],
        center_m: Float64[np.ndarray, "3"],
        shutter: ShutterModel,
        fastest_m_s: float,
    ) -> DropCulling:
        """Visibility tests of drops in a cell with these axes and center; `turn` is the region's rotation."""
        rain, camera, size = self.rain, shutter.camera, np.array(self.rain.streak_region.size_m)
        far = rain.critical_haze_coefficient * visible_distance_m(self.diameters_mm, shutter.focal_px)
        eye = np.zeros(3) if rain.is_paper else shutter.velocity_m_s
        fall = self.motion.fall_speed_m_s
        own = 5 * self.motion.turbulence_m_s  # 3.45 standard deviations on two axes
        level, down = fastest_m_s + own + float(np.hypot(eye[0], eye[1])), fall + eye[2]
        speeds = np.sqrt(level * level + down * down)
        blur, readout_s, stretch = np.zeros(len(far)), shutter.readout.time_s, 1.0
        if shutter.lens.aperture_m:  # five standard deviations of the largest circle of confusion up to that depth
            farthest = float(np.linalg.norm(camera.position - center_m) + np.linalg.norm(size) / 2)
            circles = (shutter.lens.circle_of_confusion_m(d) for d in (0 * far, np.minimum(far, farthest)))
            blur = 5 / 4 * np.maximum(*circles)
        if readout_s:
            blur, stretch = blur + speeds * readout_s / 2, MAX_STRETCH
        return DropCulling(
            region_rotation=np.ascontiguousarray(turn[:2, :2].T @ axes[:2, :2]),
            region_half=size / 2,
            camera_position=axes.T @ (camera.position - center_m),
            cell_to_camera=np.ascontiguousarray(camera.world_to_camera[:3, :3] @ axes),
            slopes=camera_slopes(camera),
            class_margin_m=STREAK_REACH * stretch * shutter.exposure_s * speeds + 0.02 + blur,
            class_far_m=far,
        )


_MOVING = (
    "intensity_mm_h", "wind_speed_m_s", "wind_from_deg", "gust_m_s", "turbulence_m_s", "roughness_m", "seed",
    "velocity", "calibration", "diameter_scale", "model",
)  # fmt: skip
"""Fields of the rain that determine the fall and drift of drops under keyframes."""


def _drops(
    rain: RainSettings, calibration: Calibration
) -> tuple[RainProperties, Float64[np.ndarray, " classes"], Wind, Float64[np.ndarray, " classes"]]:
    """Properties, diameters (mm), wind and fall speeds (m/s); the paper's drops fall straight down."""
    state = rain_properties(rain, calibration)
    diameters = state.sizes.class_diameters_mm
    wind = Wind() if rain.is_paper else wind_of(rain)
    return state, diameters, wind, fall_speed(rain, calibration)(diameters)


def mean_linear_color(colors: Float64[np.ndarray, "n 3"]) -> tuple[float, float, float]:
    """Mean of the sky's display colors in linear light (paper, eq. 3), as a display color."""
    red, green, blue = linear_to_srgb(srgb_to_linear(colors).mean(axis=0))
    return float(red), float(green), float(blue)
