"""How HUGSIM sets a drive up: six cameras of 800 x 450 with nuScenes' names, the ego box around the front one."""

from collections.abc import Mapping
from dataclasses import replace

import msgspec
import numpy as np

from gsrain_engine.scene.scene import RigCamera, Scene
from gsrain_engine.scene.street.rigs import street_rigs

from ..agents.lidar_mount import front_camera
from ..scenario.scenario import Scenario
from ..vehicle.vehicle import HUGSIM_VEHICLE

CAMERA_NAMES = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")
"""UniAD's and VAD's clients need all six, LTF's the three in front."""
WIDTH_PX, HEIGHT_PX = 800, 450
"""Clients resize to 1600 x 900 and double the intrinsics, or say 1920 x 1080: no other size is right for them."""
RIG = "hugsim"


def in_hugsim_setting(scenario: Scenario, scene: Scene) -> tuple[Scenario, Scene]:
    """Return a scenario and its scene with HUGSIM's vehicle and a rig "hugsim" for its clients.

    HUGSIM steers the point that carries the front camera, with the ego box around it. So does this: the rig is moved
    back until its front camera stands above the vehicle's point of reference, and plans need no turning into another
    point's. Raises ValueError where the scene has no rig with a front camera.
    """
    rig = hugsim_rig(_best_rig(scenario.rig, scene))
    scenario = msgspec.structs.replace(scenario, vehicle=HUGSIM_VEHICLE, rig=RIG, picture_width_px=WIDTH_PX)
    return scenario, replace(scene, rigs={**scene.rigs, RIG: rig})


def hugsim_rig(cameras: tuple[RigCamera, ...]) -> tuple[RigCamera, ...]:
    """Return those cameras of a rig that HUGSIM's clients know, in their size, the front one above the origin.

    A picture that is higher than 16 : 9 is cut evenly at top and bottom, one that is lower shows more.
    """
    known = _by_name(cameras)
    if CAMERA_NAMES[0] not in known:
        names = ", ".join(each.name for each in cameras) or "no cameras"
        raise ValueError(f"a rig for HUGSIM's clients needs a camera CAM_FRONT (or FRONT), not only {names}")
    back = -front_camera(tuple(known.values())).camera_to_ego[:3, 3] * (1, 1, 0)
    return tuple(_of_size(_moved(known[name], back), name) for name in CAMERA_NAMES if name in known)


def all_six(cameras: tuple[RigCamera, ...]) -> Mapping[str, RigCamera]:
    """Return HUGSIM's six cameras by name: the rig's own, and for those it lacks nuScenes', around the same front one.

    Raises ValueError where the rig's are of another size.
    """
    own = {each.name: each for each in cameras if each.name in CAMERA_NAMES}
    front = CAMERA_NAMES[0]
    if front not in own:
        raise ValueError(f"HUGSIM's clients need a camera {front}: drive with the rig {RIG!r} of `in_hugsim_setting`")
    for each in own.values():
        if (each.width, each.height) != (WIDTH_PX, HEIGHT_PX):
            raise ValueError(
                f"camera {each.name} is {each.width} x {each.height}: HUGSIM's clients take {WIDTH_PX} x {HEIGHT_PX}"
            )
    usual = {each.name: each for each in hugsim_rig(street_rigs()["nuscenes"])}
    shift = own[front].camera_to_ego[:3, 3] - usual[front].camera_to_ego[:3, 3]
    return {name: own[name] if name in own else _moved(usual[name], shift) for name in CAMERA_NAMES}


def _best_rig(name: str | None, scene: Scene) -> tuple[RigCamera, ...]:
    if name is not None and name not in scene.rigs:
        raise ValueError(f"scene {scene.name!r} has no rig {name!r}, only {', '.join(scene.rigs) or 'none'}")
    rigs = list(scene.rigs.values()) if name is None else [scene.rigs[name]]
    return max(rigs, key=lambda rig: len(_by_name(rig)), default=())


def _by_name(cameras: tuple[RigCamera, ...]) -> dict[str, RigCamera]:
    """Cameras by nuScenes' names; FRONT_LEFT counts as CAM_FRONT_LEFT."""
    named = {f"CAM_{each.name.upper().removeprefix('CAM_')}": each for each in cameras}
    return {name: named[name] for name in CAMERA_NAMES if name in named}


def _moved(camera: RigCamera, by_m: np.ndarray) -> RigCamera:
    pose = camera.camera_to_ego.copy()
    pose[:3, 3] += by_m
    return replace(camera, camera_to_ego=pose)


def _of_size(camera: RigCamera, name: str) -> RigCamera:
    scale = WIDTH_PX / camera.width
    cut = (camera.height * scale - HEIGHT_PX) / 2
    return replace(
        camera, name=name, width=WIDTH_PX, height=HEIGHT_PX, fx=camera.fx * scale, fy=camera.fy * scale,
        cx=camera.cx * scale, cy=camera.cy * scale - cut,
    )  # fmt: skip
