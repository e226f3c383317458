"""What `gsrain info` prints about a capture, and what it checks and draws when it is asked to."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from PIL import Image

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.capture_summary import CaptureSummary, summarized
from gsrain_engine.datasets.checks.pose_checks import PoseCheck, check_poses
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from gsrain_engine.datasets.overlay import contact_sheet
from gsrain_engine.datasets.readable_pictures import readable_pictures
from gsrain_engine.render.pictures import write_sheet

from ..console import Table, print, wide_console
from .progress import progress_bar


def capture_info(path: Path, check: bool, overlay: Path | None) -> dict[str, Any]:
    """Print what a capture holds; `check` reads all pictures and checks poses, `overlay` is drawn into that file.

    Returns the printed numbers. Raises `CaptureError`.
    """
    found = capture_format(path)
    capture = open_capture(path)
    checks: tuple[PoseCheck, ...] = ()
    if check:
        capture, checks = _checked(capture)
    summary = summarized(capture)
    kind = found.name if found is not None else ""
    _print(summary, kind, checks, check)
    if overlay is not None:
        write_sheet(overlay, Image.fromarray(contact_sheet(capture)))
        print(f"{overlay}: points and boxes drawn into views")
    numbers = {"capture": summary.name, "format": kind, **asdict(summary)}
    return numbers | ({"checks": [asdict(each) for each in checks]} if check else {})


def _checked(capture: Capture) -> tuple[Capture, tuple[PoseCheck, ...]]:
    with progress_bar("Checking", 2.0) as advance:
        done = 0.0

        def show(fraction: float) -> None:
            nonlocal done
            advance(fraction - done)
            done = fraction

        capture = readable_pictures(capture, show)
        checks = check_poses(capture, lambda fraction: show(1.0 + fraction))
        show(2.0)  # also where there is nothing to check poses by
        return capture, checks


def _print(summary: CaptureSummary, kind: str, checks: tuple[PoseCheck, ...], checked: bool) -> None:
    console = wide_console()
    lasts = f" over {summary.seconds:.1f} s" if summary.seconds >= 0.05 else ""
    console.print(f"{summary.name}: {kind}, {_counted(summary.views, 'view')}{lasts}")
    if summary.has_poses:
        up = ", ".join(f"{round(value, 3) + 0.0:g}" for value in summary.up)
        console.print(f"{_places(summary)}; up = ({up})")
    if summary.points:
        console.print(f"{_counted(summary.points, 'point')} on surfaces")
    if summary.sweeps:
        console.print(f"lidar: {_counted(summary.sweeps, 'sweep')}, {_counted(summary.lidar_points, 'point')}")
    if summary.boxes:
        things = ", ".join(f"{count} {name}" for name, count in summary.boxes.items())
        console.print(f"boxes: {things}")
    if summary.has:
        console.print(f"each view has: {', '.join(summary.has)}")
    for name, counted in summary.attributes.items():
        values = ", ".join(f"{value} ({count})" for value, count in counted.items())
        console.print(f"{name}: {values}")
    console.print(_cameras(summary))
    for each in checks:
        console.print(f"{each.verdict}: {each.told}")
    if checked and not checks and summary.has_poses:
        console.print("poses: nothing to check them by (no lidar, and no neighbouring views that share enough)")
    for problem in summary.problems:
        console.print(f"problem: {problem}")


def _places(summary: CaptureSummary) -> str:
    unit = "m" if summary.is_metric else "units of unknown length"
    sides = [high - low for low, high in zip(summary.minimum, summary.maximum, strict=True)]
    if max(sides) < 1e-6:
        return "the camera stood still"
    extent = " x ".join(f"{side:.2f}" for side in sides)
    way = f", on a way of {summary.course:.2f}" if summary.course > 0 else ""
    return f"cameras stood within {extent} {unit}{way}"


def _counted(count: int, noun: str) -> str:
    return f"{count:,} {noun}" + ("" if count == 1 else "s")


def _cameras(summary: CaptureSummary) -> Table:
    table = Table(box=None)
    for title in ("camera", "views", "size", "focal length px", "field of view", "lens"):
        table.add_column(title, no_wrap=True)
    for each in summary.sensors:
        focal = f"{each.focal_px[0]:.1f} {each.focal_px[1]:.1f}"
        size = f"{each.width}x{each.height}"
        if each.sizes > 1:
            (a, b), (c, d) = each.smallest_px, each.largest_px
            size = f"{a}x{b} to {c}x{d} ({each.sizes} sizes)"
        fov = f"{each.horizontal_fov_deg:.1f} deg"
        table.add_row(each.name or "-", str(each.views), size, focal, fov, each.lens.partition(" ")[0] or "straight")
    return table
