"""How long threads of OpenMP (our kernels, torch) stay awake while they wait for each other."""

import os

_SPINS = "20000"
"""GCC's OpenMP waits 300,000 spins before it sleeps, time that another process on the same cores lacks. With 5,000 and
fewer torch's threads are woken anew for every small product of matrices (docs/performance.md)."""


def wait_briefly() -> None:
    """Let waiting threads sleep soon, unless the user has said how they wait.

    OpenMP reads it when the first library with threads is loaded.
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", _SPINS)
