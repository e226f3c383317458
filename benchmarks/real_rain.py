"""Does our rain look like real rain? Draws the numbers of `gsrain evaluate streaks` as docs/images/real_rain.png.

First `gsrain evaluate streaks RAINSENSE --exposure 0.004,0.008,0.016 --json streaks.json`, then
`python benchmarks/real_rain.py streaks.json docs/images/real_rain.png`.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

COLORS = ("#9ecae1", "#4292c6", "#08519c")
REAL = {"color": "black", "linewidth": 1.8, "label": "real"}
CUT_PX = 300.0


def main(numbers: Path, picture: Path) -> None:
    """Draw one column for each sequence in rain: lengths, angles, and rise by background."""
    report = json.loads(numbers.read_text(encoding="utf-8"))
    rows = [row for row in report["rows"] if row["labelled_mm_h"] > 0]
    figure = Figure(figsize=(3.1 * len(rows), 7.6), layout="constrained")
    axes = figure.subplots(3, len(rows), squeeze=False)
    for column, row in zip(axes.T, rows, strict=True):
        measured = [(row["real"], REAL), *((each, ours(k, each)) for k, each in enumerate(row["ours"]))]
        for each, style in measured:
            lengths(column[0], each["streak"], np.array(report["length_edges_px"]), style)
            angles(column[1], each["streak"], np.array(report["angle_edges_deg"]), style)
            rises(column[2], each["by_background"], style)
        column[0].set(title=f"{row['labelled_mm_h']:g} mm/h", xlabel="length, px", yscale="log")
        column[1].set(xlabel="angle from the vertical, degrees", xlim=(-45, 45))
        column[2].set(xlabel="gray of the background", ylim=(0, 20))
    axes[0, 0].set_ylabel("per megapixel and 10 px")
    axes[1, 0].set_ylabel("share in each 5 degrees")
    axes[2, 0].set_ylabel("median rise, gray levels")
    axes[0, -1].legend(frameon=False, fontsize=8)
    figure.savefig(picture, dpi=100)


def ours(k: int, measured: dict[str, Any]) -> dict[str, Any]:
    """Style of our rain at an exposure."""
    color = COLORS[k % len(COLORS)]
    return {"color": color, "linewidth": 1.2, "label": f"ours, {1e3 * measured['exposure_s']:g} ms"}


def lengths(axes: Axes, streak: dict[str, Any], edges: np.ndarray, style: dict[str, Any]) -> None:
    """Streaks of each length, per searched megapixel and 10 px of length."""
    edges = np.minimum(edges, CUT_PX)
    if streak["megapixels"]:
        axes.stairs(np.array(streak["length_histogram"]) / streak["megapixels"] / (np.diff(edges) / 10), edges, **style)


def angles(axes: Axes, streak: dict[str, Any], edges: np.ndarray, style: dict[str, Any]) -> None:
    """Share of the streaks at each angle."""
    counts = np.array(streak["angle_histogram"])
    axes.stairs(counts / max(counts.sum(), 1), edges, **style)


def rises(axes: Axes, bands: list[dict[str, Any]], style: dict[str, Any]) -> None:
    """Median rise before backgrounds of each brightness, where there are ten streaks or more."""
    known = [band for band in bands if band["streaks"] >= 10]
    middles = [sum(band["band_levels"]) / 2 for band in known]
    axes.plot(middles, [band["rise_levels"][1] for band in known], marker="o", markersize=3, **style)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
