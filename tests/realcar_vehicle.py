"""Checkpoints as HUGSIM's `capture` writes them, and made-up vehicles in the layout of its 3DRealCar release."""

import json
from pathlib import Path

import numpy as np
import torch

VEHICLE_CLASS = 13


def state(means, classes, generator, *, scale_columns=3, sh_degree=1, extra=(1.0,)):
    """Values that `capture` of a model returns, as parameters on the CPU."""
    count = len(means)
    features = torch.full((count, 20), -3.0)
    features[torch.arange(count), torch.as_tensor(classes)] = 3.0
    arrays = (
        torch.as_tensor(np.asarray(means), dtype=torch.float32),
        torch.randn(count, 1, 3, generator=generator),
        torch.randn(count, 15, 3, generator=generator),
        features,
        torch.full((count, scale_columns), -2.0),
        torch.randn(count, 4, generator=generator),
        torch.linspace(-2, 2, count)[:, None],
    )
    return (sh_degree, *(torch.nn.Parameter(each) for each in arrays), *extra)


def write_vehicle(folder: Path, means, size_wlh) -> None:
    """Write gs.pth, with means in the vehicle's axes (x forward, y down, z left), and wlh.json."""
    folder.mkdir(parents=True, exist_ok=True)
    generator = torch.Generator().manual_seed(2)
    torch.save((state(means, [VEHICLE_CLASS] * len(means), generator), 30_000), folder / "gs.pth")
    (folder / "wlh.json").write_text(json.dumps(list(size_wlh)))
