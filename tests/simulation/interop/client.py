"""A HUGSIM client, written from a description of the protocol alone: NumPy, plain pickles, two named pipes.

    python client.py FOLDER [keep|brake|list|none|garbage|die|die-reading|hang|deaf]

It imports nothing of the project, and runs under any Python 3.8 or NumPy 1.2x that stacks are pinned to.
"""

import contextlib
import json
import os
import pickle
import signal
import sys
from pathlib import Path

import numpy as np

CAMERAS = ["CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT"]
SPACING = 0.5
NEAR = 14.0


def focal(fov, pixels):
    return pixels / (2 * np.tan(fov / 2))


def look_at(obs, info):
    """Check what came, as stacks rely on it; returns plain notes for whoever started this."""
    assert set(obs) == {"rgb", "semantic", "depth"}, set(obs)
    for camera in CAMERAS:
        image = obs["rgb"][camera]
        assert type(image) is np.ndarray and image.dtype == np.uint8 and image.shape == (450, 800, 3)
        assert image.flags.writeable and image.flags.c_contiguous
        params = info["cam_params"][camera]
        assert params["intrinsic"]["W"] == 800 and params["intrinsic"]["H"] == 450
        for name in ("l2c", "v2c"):
            assert params[name].shape == (4, 4) and params[name].dtype == np.float64
            assert abs(np.linalg.det(params[name][:3, :3]) - 1) < 1e-9
    for name in ("ego_velo", "ego_steer", "accelerate", "steer_rate", "timestamp", "rc"):
        assert type(info[name]) is float, (name, type(info[name]))
    assert type(info["command"]) is int and info["command"] in (0, 1, 2)
    assert type(info["collision"]) is bool
    assert len(info["ego_pos"]) == 3 and len(info["ego_rot"]) == 3 and len(info["ego_box"]) == 7
    front = info["cam_params"]["CAM_FRONT"]
    return {
        "timestamp": info["timestamp"], "ego_pos": info["ego_pos"], "ego_rot": info["ego_rot"],
        "ego_velo": info["ego_velo"], "ego_box": info["ego_box"], "obj_boxes": info["obj_boxes"], "rc": info["rc"],
        "focal": focal(front["intrinsic"]["fovx"], 800), "l2c": front["l2c"].tolist(), "v2c": front["v2c"].tolist(),
        "brightness": {camera: float(obs["rgb"][camera].mean()) for camera in CAMERAS},
        "first_pixel": obs["rgb"]["CAM_FRONT"][200, 400].tolist(), "semantic": sorted(obs["semantic"]),
        "depth": sorted(obs["depth"]), "numpy": np.__version__,
    }  # fmt: skip


def ahead_of(info):
    """Distance to the nearest box ahead, between middles, in axes x forward, y left."""
    x, y, yaw = info["ego_pos"][2], -info["ego_pos"][0], -info["ego_rot"][1]
    nearest = np.inf
    for box in info["obj_boxes"]:
        forward = np.cos(yaw) * (box[0] - x) + np.sin(yaw) * (box[1] - y)
        left = np.cos(yaw) * (box[1] - y) - np.sin(yaw) * (box[0] - x)
        if forward > 0 and abs(left) < (box[3] + info["ego_box"][3]) / 2:
            nearest = min(nearest, forward)
    return nearest


def plan_for(info, mode, cruise):
    """Points x right, y forward."""
    times = SPACING * np.arange(1, 7)
    speed = 0.0 if mode == "brake" and ahead_of(info) < NEAR else cruise
    plan = np.stack([np.zeros(6), speed * times], axis=1)
    return plan.tolist() if mode == "list" else plan


def main():
    folder, mode = Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "brake"
    obs_pipe, plan_pipe = folder / "obs_pipe", folder / "plan_pipe"
    for pipe in (obs_pipe, plan_pipe):
        with contextlib.suppress(FileExistsError):
            os.mkfifo(pipe)
    notes, cruise = [], None
    while True:
        if mode == "die-reading":
            with obs_pipe.open("rb") as pipe:
                pipe.read(1000)
            sys.exit("there is a hole in the road")
        with obs_pipe.open("rb") as pipe:
            message = pickle.loads(pipe.read())
        if isinstance(message, str) and message == "Done":
            break
        notes.append(look_at(*message))
        info = message[1]
        cruise = info["ego_velo"] if cruise is None else cruise
        late = len(notes) >= 2
        if late and mode == "die":
            sys.exit("the engine is out of oil")
        if late and mode == "hang":
            signal.pause()
        reply = None if late and mode == "none" else plan_for(info, mode, cruise)
        with plan_pipe.open("wb") as pipe:
            pipe.write(b"no pickle" if late and mode == "garbage" else pickle.dumps(reply))
        if late and mode == "none":
            break
        if mode == "deaf":
            signal.pause()
    (folder / "notes.json").write_text(json.dumps(notes))


if __name__ == "__main__":
    main()
