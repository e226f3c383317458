"""What a disdrometer file gives: spectra, single drops where the instrument sees them, and what was left out."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Shaped

from gsrain_engine.rain.disdrometer.spectra import DropSpectra
from gsrain_engine.untrusted.printable import printable


class DisdrometerFileError(ValueError):
    """A file from which no record can be taken, in one sentence: which file, which record, and why."""

    def __init__(self, path: Path, reason: str):
        super().__init__(f"{path}: {printable(reason)}")


KNOWN_KINDS = (
    "OTT Parsivel (telegrams, ASDO's text, station logs, Campbell TOA5, CSV of pyAtmosLogger and SCAMP, NetCDF of "
    "Cloudnet, ARM and DISDRODB), Thies LNM (telegrams, NetCDF), Joss-Waldvogel RD-80 (text, ARM's NetCDF), "
    "2DVD (ARM's NetCDF, NASA's tables), APU (NASA's tables), RainSense, what gsrain disdrometer -o writes"
)
"""Files that are told apart by what they hold, for people."""


class UnknownKindError(DisdrometerFileError):
    """A file of no kind that is known; `problem` says so without its name.

    `kind` says what else it is, where that is plain ("an archive: unpack it").
    """

    def __init__(self, path: Path, what: str, kind: str | None = None):
        other = "of any other table of text say which column is what, by --columns FILE.yaml"
        known = f"{printable(what)}; known are {KNOWN_KINDS}; {other}"
        self.problem = known if kind is None else f"not a disdrometer file; it is {kind}"
        self.kind = kind
        ValueError.__init__(self, f"{path}: {self.problem}")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SingleDrops:
    """Drops seen one by one, in order of time."""

    diameters_mm: Float64[np.ndarray, " drops"]
    """Diameter of the sphere that holds the drop's water."""
    speeds_m_s: Float64[np.ndarray, " drops"]
    """Fall speed, downwards positive."""
    axis_ratios: Float64[np.ndarray, " drops"]
    """Height over width; NaN where it wasn't measured."""
    times: Shaped[np.ndarray, " drops"]
    """UTC, datetime64[ms]."""

    def __len__(self) -> int:
        return len(self.diameters_mm)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Reading:
    """One file, read."""

    spectra: DropSpectra
    drops: SingleDrops | None = None
    """Where the instrument sees single drops (2DVD)."""
    skipped: tuple[str, ...] = ()
    """One sentence for each record left out: which, and why."""
