"""`gsrain evaluate rain-gauge`: the rain rate in frames of a static camera, as a camera rain gauge reads it.

It uses number, widths and lengths of streaks alone, neither the scene nor the rain that was set. Frames need dark and
bright backgrounds above the horizon, such as trees and sky, by which the light of drops is found.
"""

from collections.abc import Iterator
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from app.console import print
from app.options import JsonFile, check_within, option, setting
from app.outputs import check_writable, write_numbers
from gsrain_engine.rain.settings import RainSettings

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import UInt8


_MAX_FRAMES, _MAX_BYTES = 500, 3 << 29


def rain_gauge(
    frames: Annotated[Path, option("Folder of images, or a video (.mp4, .webm), of a static, level camera.", "FRAMES")],
    /,
    *,
    focal_px: Annotated[float, option("Focal length in pixels of the frames.")],
    shutter: Annotated[float, option("Shutter time in s; at 2 ms, streaks are long enough and seldom cross.")],
    calibration: Annotated[
        str, setting(RainSettings, "calibration", "Its law of the fall speed is used.")
    ] = "published",
    count: Annotated[int, option("Number of frames, from the first one.")] = 32,
    horizon_px: Annotated[
        int | None,
        option("Row of the horizon: rain is measured above it, since drops splash below. Default: the middle."),
    ] = None,
    json: JsonFile = None,
) -> None:
    """Rain rate in frames of a static camera, by their streaks."""
    from gsrain_engine.rain.calibration import load_calibration
    from gsrain_engine.rain.properties import rain_class

    from .rain_gauge import MIN_FRAMES, measure_rain_rate

    check_within("--focal-px", focal_px, 10, 1e5, "px")
    check_within("--shutter", shutter, 1e-4, 0.1, "s")
    check_within("--count", count, MIN_FRAMES, _MAX_FRAMES)
    check_writable(json)
    fall_speed = load_calibration(calibration).velocity
    pictures = _stacked(frames, islice(_pictures(frames), count))
    if horizon_px is not None:
        check_within("--horizon-px", horizon_px, 64, pictures.shape[1], "px")
    found = measure_rain_rate(pictures, focal_px, shutter, fall_speed, horizon_px)
    print(
        f"{found.intensity_mm_h:.2f} mm/h ({rain_class(found.intensity_mm_h)}), counting error {found.error_mm_h:.2f}: "
        f"{found.streaks} streaks wider than {found.cutoff_px:.1f} px in {found.frames} frames, "
        f"{found.water_g_m3:.3f} g/m3 of water, drops of {found.diameter_mm:.1f} mm at {found.speed_m_s:.1f} m/s; "
        f"light of drops {found.drop_light:.2f}, {found.recovered_share:.0%} of artificial streaks found"
    )
    write_numbers(json, asdict(found))


def _pictures(source: Path) -> "Iterator[UInt8[np.ndarray, 'h w 3']]":
    from gsrain_engine.datasets.io.images import images_in, read_color
    from gsrain_engine.render.video import SUFFIXES, read_video

    if source.suffix.lower() in SUFFIXES:
        return read_video(source)
    if not (files := images_in(source)):
        raise ValueError(f"{source}: no images in it; frames are a folder of PNG or JPEG images, or a video")
    return map(read_color, files)


def _stacked(source: Path, pictures: "Iterator[UInt8[np.ndarray, 'h w 3']]") -> "UInt8[np.ndarray, 't h w 3']":
    import numpy as np

    from .rain_gauge import MIN_FRAMES

    found: list[UInt8[np.ndarray, "h w 3"]] = []
    for picture in pictures:
        found.append(picture)
        if picture.shape != found[0].shape:
            raise ValueError(f"{source}: frame {len(found)} has another size than the first")
        if len(found) * picture.nbytes > _MAX_BYTES:
            raise ValueError(f"{source}: frames too large for {len(found)} of them; take fewer by --count")
    if len(found) < MIN_FRAMES:
        raise ValueError(f"{source}: {len(found)} frames, a rain gauge needs {MIN_FRAMES} or more")
    return np.stack(found)
