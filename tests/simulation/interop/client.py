"""A HUGSIM client, written from a description of the protocol alone: NumPy, plain pickles, two named pipes.

    python client.py FOLDER [keep|brake|list|none|garbage|die|die-reading|hang|deaf]

It imports nothing of the project, and runs under any Python 3.8 or NumPy 1.2x that stacks are pinned to.
"""

import json
import os
import pickle
import signal
import sys
from pathlib import Path

import numpy as np

CAMERAS = ["CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT"]
NEAR = 14.0


def notes_of(obs, info):
    """Check a message, as stacks rely on it; returns plain notes for the test."""
    assert set(obs) == {"rgb", "semantic", "depth"}, set(obs)
    for camera in CAMERAS:
        image = obs["rgb"][camera]
        assert type(image) is np.ndarray and image.dtype == np.uint8 and image.shape == (450, 800, 3)
        assert image.flags.writeable and image.flags.c_contiguous
        for name in ("l2c", "v2c"):
            pose = info["cam_params"][camera][name]
            assert pose.shape == (4, 4) and pose.dtype == np.float64
    for name in ("ego_velo", "ego_steer", "accelerate", "steer_rate", "timestamp", "rc"):
        assert type(info[name]) is float, (name, type(info[name]))
    assert type(info["command"]) is int and type(info["collision"]) is bool
    plain = {name: info[name] for name in ("timestamp", "ego_pos", "ego_rot", "ego_velo", "obj_boxes", "rc")}
    return {
        **plain,
        "brightness": {camera: float(obs["rgb"][camera].mean()) for camera in CAMERAS},
        "first_pixel": obs["rgb"]["CAM_FRONT"][200, 400].tolist(),
        "semantic": sorted(obs["semantic"]),
        "depth": sorted(obs["depth"]),
    }


def plan_for(info, mode, cruise):
    """Points x right, y forward; the first box is of a road user straight ahead."""
    away = info["obj_boxes"][0][0] - info["ego_pos"][2]
    speed = 0.0 if mode == "brake" and away < NEAR else cruise
    plan = np.stack([np.zeros(6), speed * 0.5 * np.arange(1, 7)], axis=1)
    return plan.tolist() if mode == "list" else plan


def main():
    folder, mode = Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "brake"
    obs_pipe, plan_pipe = folder / "obs_pipe", folder / "plan_pipe"
    for pipe in (obs_pipe, plan_pipe):
        if not pipe.exists():
            os.mkfifo(pipe)
    notes = []
    while True:
        with obs_pipe.open("rb") as pipe:
            if mode == "die-reading":
                pipe.read(1000)
                sys.exit("there is a hole in the road")
            message = pickle.loads(pipe.read())
        if isinstance(message, str) and message == "Done":
            break
        notes.append(notes_of(*message))
        late = len(notes) >= 2
        if late and mode == "die":
            sys.exit("the engine is out of oil")
        if late and mode == "hang":
            signal.pause()
        gives_up = late and mode == "none"
        reply = None if gives_up else plan_for(message[1], mode, notes[0]["ego_velo"])
        with plan_pipe.open("wb") as pipe:
            pipe.write(b"no pickle" if late and mode == "garbage" else pickle.dumps(reply))
        if gives_up:
            break
        if mode == "deaf":
            signal.pause()
    (folder / "notes.json").write_text(json.dumps(notes))


if __name__ == "__main__":
    main()
