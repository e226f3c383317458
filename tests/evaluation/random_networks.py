"""Networks that have seen nothing: they run the code of the real ones."""

from pathlib import Path

import numpy as np

from gsrain_engine.evaluation.lpips_weights import write_arrays


def random_arrays(make, seed=0):
    """Arrays for every name of a network, of sizes at which signals neither die nor explode."""
    random = np.random.default_rng(seed)
    from gsrain_engine.evaluation.fid_torch_features import build_without_weights  # torch is an extra

    arrays: dict[str, np.ndarray] = {}
    for name, tensor in build_without_weights(make).state_dict().items():
        shape = tuple(tensor.shape)
        if len(shape) == 4:
            values = random.normal(0, (2 / np.prod(shape[1:])) ** 0.5, shape)
        elif name.endswith(("running_var", "weight")):
            values = random.uniform(0.5, 1.5, shape)
        else:
            values = random.normal(0, 0.1, shape)
        arrays[name] = values.astype(np.float32)
    return arrays


def write_inception(file: Path, seed=0) -> Path:
    from gsrain_engine.evaluation.fid_torch_features import Inception

    write_arrays(file, {**random_arrays(Inception, seed), "fc.weight": np.zeros((1008, 2048), np.float32)})
    return file
