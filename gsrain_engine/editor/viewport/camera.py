"""Viewport camera: orbit, fly, dolly, pan, frame; home camera and default path. World frame (meters, z up)."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64

from ...scene.camera import Camera, look_at
from ...scene.camera_path import CameraPath, orbit_path
from ...scene.rig import rig_camera_path
from ...scene.scene import RigCamera, Scene, SceneCore, ahead_of, core_bounds

_STEEPEST = np.radians(90.0)
_UP = np.array([0.0, 0.0, 1.0])
_VERTICAL = 1e-6  # horizontal part of a line of sight without a heading
_NEAREST_M = 0.05  # distance at which the wheel moves the target ahead
SLOWEST_M_S, FASTEST_M_S = 0.05, 500.0


@dataclass(slots=True)
class OrbitCamera:
    """Position, heading and pitch, and the distance of the orbit target."""

    position: Float64[np.ndarray, "3"] = field(default_factory=lambda: np.array([0.0, 0.0, 1.5]))
    heading: float = 0.0
    """Radians from +x to +y."""
    pitch: float = 0.0
    """Radians, upward."""
    distance_m: float = 5.0
    """Distance of the orbit target ahead."""
    vertical_fov_deg: float = 50.0
    speed_m_s: float = 5.0
    velocity_m_s: Float64[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Velocity of the last `fly`; rain slants for a moving camera."""
    pivot: Float64[np.ndarray, "3"] | None = None
    """Point of the world that an orbit turns around; None is the orbit target, ahead."""

    @property
    def forward(self) -> Float64[np.ndarray, "3"]:
        """Unit vector of the line of sight."""
        c = np.cos(self.pitch)
        return np.array([c * np.cos(self.heading), c * np.sin(self.heading), np.sin(self.pitch)])

    @property
    def right(self) -> Float64[np.ndarray, "3"]:
        """Horizontal unit vector to the right."""
        return np.array([np.sin(self.heading), -np.cos(self.heading), 0.0])

    @property
    def upward(self) -> Float64[np.ndarray, "3"]:
        """Unit vector that is upwards in the image."""
        c, s = np.cos(self.pitch), np.sin(self.pitch)
        return np.array([-s * np.cos(self.heading), -s * np.sin(self.heading), c])

    @property
    def target(self) -> Float64[np.ndarray, "3"]:
        return self.position + self.distance_m * self.forward

    def camera(self, width: int, height: int) -> Camera:
        """Camera for an image of a size."""
        pose = np.eye(4)
        pose[:3, :3] = self.right, -self.upward, self.forward
        pose[:3, 3] = -pose[:3, :3] @ self.position
        return Camera.from_fov(width, height, self.vertical_fov_deg, pose)

    def look_like(self, camera: Camera) -> None:
        """Use the position, line of sight and field of view of a camera; roll is lost."""
        self.position, self.vertical_fov_deg, self.pivot = camera.position.copy(), camera.vertical_fov_deg, None
        self._look_along(camera.world_to_camera[2, :3], camera.world_to_camera[0, :3])

    def carry(self, similarity: Float64[np.ndarray, "4 4"]) -> None:
        """Apply a similarity of the world to the camera; roll is lost."""
        scale = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
        self.position = similarity[:3, :3] @ self.position + similarity[:3, 3]
        self.distance_m *= scale
        self.pivot = None
        self._look_along(similarity[:3, :3] @ self.forward / scale, similarity[:3, :3] @ self.right / scale)

    def orbit(self, right_rad: float, up_rad: float) -> None:
        """Turn around the pivot, or the target, so that the scene follows the mouse."""
        if self.pivot is None:
            target = self.target
            self.turn(-right_rad, -up_rad)
            self.position = target - self.distance_m * self.forward
            return
        away = self.position - self.pivot
        before = np.stack([self.right, self.forward, self.upward])
        self.turn(-right_rad, -up_rad)
        after = np.stack([self.right, self.forward, self.upward])
        self.position = self.pivot + after.T @ (before @ away)

    def set_pivot(self, point_m: Float64[np.ndarray, "3"]) -> None:
        """Orbit around a point from now on; wheel and pan go by its depth. The view stays."""
        self.pivot = point_m
        self.distance_m = max(float((point_m - self.position) @ self.forward), _NEAREST_M)

    def turn(self, left_rad: float, up_rad: float) -> None:
        self.heading = float(np.mod(self.heading + left_rad + np.pi, 2 * np.pi) - np.pi)
        self.pitch = float(np.clip(self.pitch + up_rad, -_STEEPEST, _STEEPEST))

    def pan(self, right_share: float, up_share: float) -> None:
        """Move across the line of sight by shares of the image height at the target's distance."""
        metres = 2 * self.distance_m * np.tan(np.radians(self.vertical_fov_deg) / 2)
        self.position = self.position + metres * (right_share * self.right + up_share * self.upward)

    def dolly(self, steps: float, core: SceneCore) -> None:
        """Move toward the target (positive) or away, by a tenth of the distance per step.

        From outside of a scene's core, moves toward the core, and turns to it first if it is out of view. A target that
        is reached moves ahead; moving away ends inside of a shell.
        """
        radius = max(core.radius_m, 1e-3)
        self._mend(core)
        gap = float(np.linalg.norm(self.position - np.clip(self.position, core.low, core.high)))
        if gap > 0:
            self.distance_m = float(np.clip(self.distance_m, gap + 0.5 * radius, gap + 2 * radius))
            if not is_in_view(core, self.position, self.forward, self.vertical_fov_deg):
                x, y, z = (core.middle - self.position).tolist()
                self.heading = float(np.arctan2(y, x))
                self.pitch = float(np.clip(np.arctan2(z, np.hypot(x, y)), -_STEEPEST, _STEEPEST))
        else:
            self.distance_m = min(self.distance_m, 2 * radius)
        distance = self.distance_m * 0.9**steps
        moved = self.position + (self.distance_m - distance) * self.forward
        before, after = (float(np.linalg.norm(each - core.middle)) for each in (self.position, moved))
        if after > max(before, core.farthest_m):
            return
        self.position, self.distance_m = moved, max(distance, min(0.01 * radius, _NEAREST_M))

    def zoom(self, steps: float) -> None:
        """Change the scale of an orthographic view by a tenth per step; its target stays."""
        target = self.target
        self.distance_m *= 0.9**steps
        self.position = target - self.distance_m * self.forward

    def fly(self, forward: float, right: float, up: float, real_s: float, *, across: bool = False) -> None:
        """Fly for a time; each direction is -1, 0 or 1. With `across`, forward is upwards in the image."""
        self.pivot = None
        ahead = self.upward if across else self.forward
        self.velocity_m_s = self.speed_m_s * (forward * ahead + right * self.right + up * _UP)
        self.position = self.position + self.velocity_m_s * real_s

    @property
    def is_flying(self) -> bool:
        """True if it has flown since it last stood still."""
        return bool(np.any(self.velocity_m_s))

    def stop(self) -> None:
        self.velocity_m_s = np.zeros(3)

    def change_speed(self, steps: float) -> None:
        """Change the flying speed, by a quarter per step."""
        self.speed_m_s = float(np.clip(self.speed_m_s * 1.25**steps, SLOWEST_M_S, FASTEST_M_S))

    def frame(self, core: SceneCore) -> None:
        """Move back along the line of sight until the scene's core fills the image, but stay inside of the shell."""
        self.pivot = None
        self._mend(core)
        fitting_m = max(core.radius_m, 1e-3) / float(np.sin(np.radians(self.vertical_fov_deg) / 2))
        self.distance_m = min(fitting_m, max(core.farthest_m, 1e-3))
        self.position = core.middle - self.distance_m * self.forward

    def _look_along(self, forward: Float64[np.ndarray, "3"], right: Float64[np.ndarray, "3"]) -> None:
        is_vertical = np.hypot(forward[0], forward[1]) < _VERTICAL
        x, y = (-right[1], right[0]) if is_vertical else forward[:2]
        self.heading = float(np.arctan2(y, x))
        self.pitch = float(np.clip(np.arcsin(np.clip(forward[2], -1, 1)), -_STEEPEST, _STEEPEST))

    def _mend(self, core: SceneCore) -> None:
        """Reset an unusable pose: non-finite or extremely far."""
        if not np.isfinite([self.heading, self.pitch]).all():
            self.heading = self.pitch = 0.0
        far = 1e6 * (core.radius_m + 1.0)
        if not (np.abs(self.position - core.middle) < far).all() or not 0 < self.distance_m < far:
            self.distance_m = max(core.radius_m, 1e-3)
            self.position = core.middle - self.distance_m * self.forward


_STEPS = 3  # of which the median counts, so that a jump to another place is no motion
_TRUST = 0.75  # share of the expected motion: hands stop and turn back


@dataclass(slots=True)
class NavigationMotion:
    """Recent motion of the viewport camera, from which its pose in a moment is expected."""

    _before: tuple[float, Float64[np.ndarray, "5"]] | None = None
    _rates: list[Float64[np.ndarray, "5"]] = field(default_factory=list[Float64[np.ndarray, "5"]])
    """Position, heading and pitch a second."""

    def observe(self, camera: OrbitCamera, now_s: float) -> None:
        """Note the pose, once a frame; `now_s` is any steady clock."""
        pose = np.array([*camera.position, camera.heading, camera.pitch])
        if self._before is not None and now_s > self._before[0]:
            step = pose - self._before[1]
            step[3] = np.mod(step[3] + np.pi, 2 * np.pi) - np.pi
            self._rates = [*self._rates, step / (now_s - self._before[0])][-_STEPS:]
        self._before = now_s, pose

    def expected(self, camera: OrbitCamera, ahead_s: float) -> OrbitCamera:
        """Return the camera as it will be if it goes on for most of the time as before."""
        rates = np.median(self._rates, axis=0) if len(self._rates) == _STEPS else np.zeros(5)
        if not (ahead_s and np.any(rates)):
            return camera
        *moved_m, turned, raised = (_TRUST * ahead_s * rates).tolist()
        later = replace(camera, position=camera.position + moved_m)
        later.turn(turned, raised)
        return later


def is_in_view(
    core: SceneCore, eye: Float64[np.ndarray, "3"], forward: Float64[np.ndarray, "3"], vertical_fov_deg: float
) -> bool:
    """Return whether a scene's core reaches into the circle within the image height; always true inside the core."""
    away, radius = core.middle - eye, max(core.radius_m, 1e-3)
    distance = float(np.linalg.norm(away))
    if distance <= radius:
        return True
    between = np.arccos(np.clip(away @ forward / distance, -1, 1))
    return bool(between - np.arcsin(radius / distance) < np.radians(vertical_fov_deg) / 2)


# Home camera and default path

FOV_DEG = 50.0
_LOOKING_DOWN_DEG = 8.0
_LOOKING_DOWN_ON_FLAT_DEG = 25.0  # for wide and low scenes such as streets, where the first houses would hide the rest
_MARGIN = 1.12  # margin around the box, which excludes 2 % along each axis
ORBIT_S, ORBIT_DEG = 8.0, 40.0
"""Duration and angle of the orbit for scenes without a drive."""


def home_camera(scene: Scene, width: int, height: int) -> Camera:
    """Front camera of the ego vehicle's rig if there is one, else a view of the scene's middle."""
    core, front = find_scene_core(scene), front_camera(scene)
    if front is not None:
        camera = rig_camera_path(scene, front, width, height).camera(0.0, width, height)
        if is_in_view(core, camera.position, camera.world_to_camera[2, :3], camera.vertical_fov_deg):
            return camera
    length, width_m, height_m = core.high - core.low
    flat = 1.0 - min(2 * height_m / max(length, width_m, 1e-9), 1.0)
    down = np.radians(_LOOKING_DOWN_DEG + flat * (_LOOKING_DOWN_ON_FLAT_DEG - _LOOKING_DOWN_DEG))
    sight = np.cos(down) * ahead_of(scene) - np.sin(down) * np.array([0, 0, 1.0])
    turn = look_at(np.zeros(3), sight, np.array([0.0, 0, 1]))[:3, :3]
    eye = core.middle - sight * min(_fitting_distance(core, turn, width / height), max(core.farthest_m, 1e-3))
    return Camera.from_fov(width, height, FOV_DEG, look_at(eye, core.middle, np.array([0.0, 0, 1])))


def _fitting_distance(core: SceneCore, world_to_camera: Float64[np.ndarray, "3 3"], aspect: float) -> float:
    """Distance from the middle at which a core fills the image: its box with a margin, or its bounding sphere."""
    upright = np.tan(np.radians(FOV_DEG) / 2)
    sphere = max(core.radius_m, 1e-3) / np.sin(np.arctan(upright * min(aspect, 1.0)))
    x, y, z = world_to_camera @ (core.corners - core.middle).T
    box = np.max(np.maximum(np.abs(x) / (upright * aspect), np.abs(y) / upright) - z)
    return float(min(sphere, _MARGIN * box + 1e-3))


def default_path(scene: Scene, width: int, height: int) -> CameraPath:
    """Path of the ego vehicle's front camera, else an orbit around the middle. World frame."""
    front = front_camera(scene)
    return orbit_around(scene, width, height) if front is None else rig_camera_path(scene, front, width, height)


def orbit_around(
    scene: Scene, width: int, height: int, duration_s: float = ORBIT_S, sweep_deg: float = ORBIT_DEG
) -> CameraPath:
    """Orbit in the world around a scene's middle, centered at its home camera; the duration must be above 0."""
    if not duration_s > 0:
        raise ValueError(f"an orbit of {duration_s:g} s: its time must be above 0 s")
    return orbit_path(find_scene_core(scene).middle, home_camera(scene, width, height), duration_s, sweep_deg)


def front_camera(scene: Scene) -> RigCamera | None:
    """Rig camera that looks most straight ahead; None without an ego vehicle or cameras."""
    if scene.ego is None or not len(scene.ego.times):
        return None
    mounted = [camera for rig in scene.rigs.values() for camera in rig]
    return max(mounted, key=lambda each: each.camera_to_ego[0, 2], default=None)


def find_scene_core(scene: Scene) -> SceneCore:
    """Find the dense core of the visible layers, and the sky around it; of the actors if no layer is visible."""
    layers = [each for each in scene.layers if each.visible]
    solid = [each for each in layers if each.kind != "sky"] or [each for each in scene.actors if each.visible]
    parts, sky = (
        [part for each in members if (part := scene.part(each)) is not None]
        for members in (solid, [each for each in layers if each.kind == "sky"])
    )
    return core_bounds(parts, sky)


def home_viewport_camera(scene: Scene, width: int, height: int, speed_m_s: float) -> OrbitCamera:
    """Camera at the home pose; its orbit target is the scene's middle, or 1 to 20 m ahead if inside of the scene."""
    camera, core = home_camera(scene, width, height), find_scene_core(scene)
    navigation = OrbitCamera(speed_m_s=speed_m_s)
    navigation.look_like(camera)
    in_front = float(camera.world_to_camera[2, :3] @ core.middle + camera.world_to_camera[2, 3])
    is_outside = float(np.linalg.norm(core.middle - camera.position)) > core.radius_m
    navigation.distance_m = max(in_front, 1e-3) if is_outside else float(np.clip(in_front, 1.0, 20.0))
    return navigation
