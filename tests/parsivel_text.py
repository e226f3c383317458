"""Small Parsivel files for tests: rain of one spectrum, in the dialects that stations write."""

from collections.abc import Sequence

import numpy as np

DRY = np.zeros((32, 32), int)


def rain() -> np.ndarray:
    """Counts by diameter and speed of a minute of light rain: 14 classes, each at about its own fall speed."""
    counts = DRY.copy()
    for diameter, velocity, drops in ((3, 11, 20), (5, 15, 30), (7, 18, 25), (9, 20, 12), (11, 21, 6), (14, 22, 1)):
        counts[diameter, velocity] = drops
        counts[diameter, velocity + 1] = drops // 2
    return counts


RAIN_MM_H = 0.7719
"""Rain rate of those drops on the effective area."""


def velocity_major(counts: np.ndarray) -> list[str]:
    """The 1024 numbers as a Parsivel writes them."""
    return [f"{count:03d}" for count in counts.T.ravel()]


def station_line(second: int, counts: np.ndarray = DRY, rate: str = "0000.000", numbers: Sequence[str] = ()) -> str:
    """One line of a station's log, a minute long."""
    head = [f"201904102307{second:02d}", rate, "0000.50", "00", "-9.999", "20000", "00060", "18162", "00000", "-06"]
    head += ["413258", "2.10.1", "4.00", "24.1", "0", "NYA", "000.050", "000"]
    return ";".join([*head, *["-9.999"] * 32, *["00.000"] * 32, *(numbers or velocity_major(counts))]) + ";"


def locarno_line(time: str, counts: np.ndarray = DRY, rate: str = "0000.000") -> str:
    """One line of Locarno's log, without a length."""
    fields = ["na", "OK", rate, "0000.02", "00", "00", "-9.999", "5000", "09893", "00000", "017", "0.04", "26.6", "0"]
    fields += ["000.002", "000", "-9.999," * 32, "00.000," * 32, ",".join(velocity_major(counts)) + ",", "0"]
    return f'610908,4610.3530,00847.2425,"{time}",' + ",".join(f'"{field}"' for field in fields)
