"""Rain calibration: drop number and size over the rainfall intensity, and fall speed over the diameter."""

from itertools import pairwise
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import yaml
from jaxtyping import Float
from msgspec import Meta

from ..presets import load_config, shipped_config_names
from ..safe_io.files import whole_file
from ..settings import Settings

_FOLDER = "calibrations"
Positive = Annotated[float, Meta(gt=0)]
Interval = tuple[float, float]


class RowConfidence(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Intervals that contain 95 % of the fits to resampled minutes."""

    density_m3: Interval
    shape: Interval
    scale_mm: Interval


class CalibrationRow(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Drops at one intensity: number density and gamma distribution of diameters (paper, table III, eq. 8)."""

    intensity_mm_h: Positive
    density_m3: Positive
    shape: Positive
    scale_mm: Positive
    minutes: int | None = None
    """Number of measured minutes that the row is fitted to; None for rows from elsewhere."""
    confidence: RowConfidence | None = None


class VelocityFit(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Fall speed in m/s as a quadratic of the diameter in mm, highest power first (paper, eq. 9)."""

    coefficients: tuple[float, float, float]
    r2: float | None = None

    def __call__(self, diameter_mm: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Evaluate up to the vertex; constant beyond it, since no drop falls slower for being larger."""
        a, b, c = self.coefficients
        d = np.minimum(diameter_mm, -b / (2 * a)) if a < 0 else np.asarray(diameter_mm)
        return (a * d + b) * d + c


class SourceFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """File that a calibration was fitted to."""

    name: str
    sha256: str


class Provenance(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Source data and method of a calibration."""

    files: tuple[SourceFile, ...]
    instrument: str
    first: str | None = None
    """End of the first record, UTC; None for files without times."""
    last: str | None = None
    records: int
    records_used: int
    highest_minute_mm_h: float | None = None
    """Highest rain rate of a minute."""
    method: str


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Drop statistics fitted to disdrometer records; saved as YAML."""

    name: str
    source: str
    rows: Annotated[tuple[CalibrationRow, ...], Meta(min_length=2)]
    velocity: VelocityFit
    diameter_growth: Annotated[float, Meta(ge=0, le=1)] | None = None
    """Exponent of R in the mean diameter beyond the calibrated range; None continues with the slopes of the rows."""
    provenance: Provenance | None = None
    """Source of the numbers; None for calibrations not fitted by this program."""

    def __post_init__(self) -> None:
        intensities = [row.intensity_mm_h for row in self.rows]
        if any(later <= earlier for earlier, later in pairwise(intensities)):
            raise ValueError(f"rows must have rising intensity_mm_h, got {intensities}")


def atlas_velocity(diameter_mm: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Fall speed in m/s after Atlas, Srivastava and Sekhon (1973): 9.65 - 10.3 exp(-0.6 D), at least 0."""
    return np.maximum(9.65 - 10.3 * np.exp(-0.6 * np.asarray(diameter_mm)), 0)


def load_calibration(name: str) -> Calibration:
    """Load a shipped calibration by name, or a calibration file by path.

    Raises `ValueError` with the file, the field and the allowed range.
    """
    return load_config(_FOLDER, name, Calibration, "calibration")


def save_calibration(calibration: Calibration, path: Path | str) -> None:
    """Write a calibration file atomically."""
    with whole_file(Path(path)) as partial:
        text = yaml.safe_dump(
            msgspec.to_builtins(calibration), sort_keys=False, default_flow_style=None, allow_unicode=True, width=120
        )
        partial.write_text(text, encoding="utf-8")


def calibration_names() -> list[str]:
    return shipped_config_names(_FOLDER)
