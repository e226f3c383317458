"""How long threads of OpenMP (our kernels, torch) stay awake while they wait for each other."""

import os

_SPINS = "20000"
"""A tenth of a millisecond. GCC's OpenMP takes 300,000 spins, which another process on the same cores lacks then;
fewer than 5,000 make torch wake its threads anew for every small product of matrices."""


def wait_briefly() -> None:
    """Let waiting threads sleep soon, unless the user has said how they wait.

    OpenMP reads it when the first library with threads is loaded.
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", _SPINS)
