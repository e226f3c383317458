"""Drives straight ahead at its speed through HUGSIM's pipes: python hugsim_client.py FOLDER."""

import pickle
import sys
from pathlib import Path

import numpy as np

folder = Path(sys.argv[1])
while True:
    message = pickle.loads((folder / "obs_pipe").read_bytes())  # a pickle that ends with the pipe
    if isinstance(message, str):  # "Done"
        break
    obs, info = message  # obs["rgb"]["CAM_FRONT"] is uint8 (450, 800, 3); info has ego_velo (m/s), command, ...
    ahead = info["ego_velo"] * 0.5 * np.arange(1, 7)
    plan = np.stack([np.zeros(6), ahead], axis=1)  # x right, y forward, meters, 0.5 s apart; None ends the drive
    (folder / "plan_pipe").write_bytes(pickle.dumps(plan))
