"""Brings a picture to the size that a network takes, as clean-fid does: filtered, in float, without rounding."""

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image


def resized(image: UInt8[np.ndarray, "h w 3"], width: int, height: int) -> Float32[np.ndarray, "hr wr 3"]:
    """Return display values of 0..255 at another size; proportions are not kept, as FID does not keep them.

    Pillow's bicubic filter, each channel as float32, widened where the picture shrinks (so that nothing aliases), and
    cut to 0..255: what Parmar et al. 2022 ("On aliased resizing and surprising subtleties in GAN evaluation") call
    clean. The libraries' quick resizing skips pixels, which alone moves FID by several units.
    """
    channels = [Image.fromarray(np.ascontiguousarray(image[..., c], np.float32)) for c in range(3)]
    sized = [np.asarray(channel.resize((width, height), Image.Resampling.BICUBIC)) for channel in channels]
    return np.clip(np.stack(sized, axis=2), 0, 255).astype(np.float32)
