"""Description of the machine, for benchmarks."""

import os
import platform
from importlib import metadata
from pathlib import Path

import numba

_PACKAGES = ("numpy", "numba", "moderngl")


def describe_machine() -> dict[str, str | int]:
    """Processor, operating system, and versions that affect speed."""
    return {
        "cpu": processor_name(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        "threads": numba.get_num_threads(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in _PACKAGES},
    }


def processor_name() -> str:
    listing = Path("/proc/cpuinfo")  # Linux only
    lines = listing.read_text().splitlines() if listing.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
