"""OpenEXR out: scene-linear colour and depth, as compositing programs take them."""

from collections.abc import Set
from pathlib import Path

import numpy as np
import OpenEXR

from gsrain_engine.scene.atomic_files import whole_file

from .frame import Frame
from .light import to_light
from .recording import Pass


def write_exr(path: Path, frame: Frame, passes: Set[Pass]) -> None:
    """Write the passes of a frame as one EXR file, whole or not at all.

    RGBA are half floats: linear light with sRGB primaries, multiplied by alpha as OpenEXR wants it; A alone where only
    alpha is asked for. Z is a 32-bit float: metres along the view axis, 0 where there is nothing. Compression is ZIP,
    which loses nothing.

    Raises `OSError` where it can't be written.
    """
    channels: dict[str, np.ndarray] = {}
    if "color" in passes:
        channels["RGBA"] = np.ascontiguousarray(to_light(frame.rgba).astype(np.float16))
    elif "alpha" in passes:
        channels["A"] = np.ascontiguousarray(frame.rgba[..., 3].astype(np.float16))
    if "depth" in passes and frame.depth is not None:
        channels["Z"] = np.ascontiguousarray(frame.depth)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside:
        try:
            OpenEXR.File(header, channels).write(str(beside))
        except RuntimeError as error:  # what its C++ says of a disk
            raise OSError(str(error)) from None
