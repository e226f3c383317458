"""How long a machine will take for a picture, before it begins: known work over a speed tried out in a moment."""

import time
from importlib import import_module
from typing import Any

torch: Any = import_module("torch")

_LINEAR, _QUADRATIC = 4.278e12, 0.190e12
"""Floating-point operations of SD-Turbo's architecture for 512 x 512 px: what grows with the pixels (convolutions), and
with their square (attention). Counted by torch's FlopCounterMode at 512 and 1024 px."""

_PROBE_CHANNELS, _PROBE_SIDE_PX = 128, 192
"""A convolution like those that the autoencoder spends its time in."""
_SHARE_OF_PROBE = {"cpu": 0.75, "cuda": 0.6}
"""How much of the probe's speed the whole network reaches."""


def estimated_seconds(width: int, height: int, device: str = "cpu", dtype: Any = None, mutual: bool = False) -> float:
    """Seconds for one picture of this size in pixels, on this machine as busy as it is now.

    Takes about a tenth of a second itself. Good to a factor of 1.5, since memory and company count as well. Mutual
    attention doubles the keys, and with them what grows with the square.
    """
    pictures = width * height / 512**2
    work = _LINEAR * pictures + _QUADRATIC * pictures**2 * (2 if mutual else 1)
    return work / (measured_speed(device, dtype) * _SHARE_OF_PROBE.get(torch.device(device).type, 0.6))


def measured_speed(device: str = "cpu", dtype: Any = None) -> float:
    """Floating-point operations a second of a 3x3 convolution, the best of three tries."""
    kind = torch.float32 if dtype is None else dtype
    channels, side = _PROBE_CHANNELS, _PROBE_SIDE_PX
    layer = torch.nn.Conv2d(channels, channels, 3, padding=1, device=device, dtype=kind)
    flow = torch.ones(1, channels, side, side, device=device, dtype=kind)
    times: list[float] = []
    with torch.inference_mode():
        for _ in range(4):
            started = time.perf_counter()
            float(layer(flow)[0, 0, 0, 0])  # reading a value waits for a GPU
            times.append(time.perf_counter() - started)
    return 2 * 9 * channels**2 * side**2 / min(times[1:])
