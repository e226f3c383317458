"""What `--lpips` names: a network whose weights this machine has, or a file of weights."""

from pathlib import Path

from gsrain_engine.evaluate.report.comparison import Distance


def perceived_distance(weights: str) -> Distance:
    """Open LPIPS of alex, vgg or a file; raises ValueError or FileNotFoundError where that can't be."""
    try:
        from gsrain_engine.evaluate.lpips import Lpips  # torch is an extra
        from gsrain_engine.evaluate.lpips_weights import find_lpips_weights, read_lpips_weights
    except ModuleNotFoundError as error:
        raise ValueError(f"--lpips needs {error.name}: pip install 'gsrain[jobs]'") from None
    if weights == "alex" or weights == "vgg":
        return Lpips(find_lpips_weights(weights)).distance
    return Lpips(read_lpips_weights(Path(weights))).distance
