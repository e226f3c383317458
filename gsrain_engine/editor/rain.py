"""Tools of the rain panels: virtual disdrometer, calibration fits, and import of measured series."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import platformdirs

from ..rain.calibration import Calibration, calibration_names, load_calibration, save_calibration
from ..rain.simulation import RainSimulation
from ..scene.progress import Progress
from .document import Document
from .jobs.job import Job, JobRunner
from .status import StatusBus

if TYPE_CHECKING:
    from ..disdrometer.file_summary import MeasurementSummary
    from ..disdrometer.fit_models import FittedCalibration
    from ..disdrometer.measurement import DisdrometerMeasurement
    from ..disdrometer.spectra import DisdrometerReading

_Result = TypeVar("_Result")
RECORD_S = 60.0
"""Interval of virtual spectra: one minute, as real disdrometers report."""


@dataclass(slots=True)
class MeasuredSeries:
    """A disdrometer file, and how its rates become rain keyframes."""

    name: str
    reading: "DisdrometerReading"
    speed_up: float = 1.0
    """Speed factor."""
    start_s: float = 0.0
    """Time of the first record."""


class CalibrationTools:
    """One measurement at a time, as a job. Main thread only."""

    def __init__(self, document: Document, jobs: JobRunner, status: StatusBus) -> None:
        self._document, self._jobs, self._status = document, jobs, status
        self.counted: DisdrometerMeasurement | None = None
        """Last measurement of the virtual disdrometer."""
        self.fitted: FittedCalibration | None = None
        self.measured: Sequence[MeasurementSummary] = ()
        """Summaries of the files of the last fit, even if it failed."""
        self.disagreeing: tuple[Path, ...] = ()
        """Files that were not fitted because their drops disagree with the instrument's own rate."""
        self.area_m2, self.seconds = 0.5, 60.0
        """Area and duration of the next virtual measurement; seconds are simulated time."""
        self.compared = "published"
        """Name or file of the calibration shown next to the rain's own."""
        self.pass_file = load_calibration(self.compared)
        """That calibration."""
        self.files: list[str] = []
        """Calibration files opened or written in this window."""
        self.series: MeasuredSeries | None = None
        """A disdrometer file about to be imported as rain keyframes."""
        self.job: Job[Any] | None = None
        """The last measurement."""

    @property
    def calibrations(self) -> list[str]:
        return [*calibration_names(), *self.files]

    @property
    def busy(self) -> str | None:
        """Description of the measurement in progress, or None."""
        return None if self.job is None or not self.job.is_pending else self.job.title

    @property
    def error(self) -> str | None:
        """Reason why the last measurement failed, in one sentence."""
        return None if self.job is None else self.job.error

    def measure(self) -> None:
        """Measure the present rain with a virtual disdrometer, from time 0 on."""
        rain = self._document.rain_now
        area_m2, seconds = self.area_m2, self.seconds

        def count() -> "DisdrometerMeasurement":
            from ..disdrometer.virtual import VirtualDisdrometer

            times = np.append(np.arange(max(1, np.ceil(seconds / RECORD_S))) * RECORD_S, seconds)
            return VirtualDisdrometer(RainSimulation.start(rain), area_m2).measure(times)

        def take(counted: "DisdrometerMeasurement") -> str:
            self.counted = counted
            measured = f"{counted.rate_mm_h:.3g} \u00b1 {counted.standard_error_mm_h:.2g}"
            return f"{measured} mm/h measured, {counted.state.implied_mm_h:.3g} set"

        self._begin(f"Count drops for {seconds:g} s", count, take)

    def fit(self, files: Sequence[Path], force: bool = False) -> None:
        """Fit a calibration to disdrometer files of one instrument; `force` accepts disagreeing rates.

        A YAML file among them describes the columns of their tables.
        """
        described = [path for path in files if path.suffix in (".yaml", ".yml")]
        tables = tuple(path for path in files if path not in described)

        def fit() -> "tuple[Sequence[MeasurementSummary], FittedCalibration | ValueError]":
            from ..disdrometer.file_summary import open_disdrometer_files
            from ..disdrometer.fit import calibrate_files
            from ..disdrometer.tables import load_columns

            if not tables or len(described) > 1:
                raise ValueError("choose disdrometer files, and at most one YAML file that describes their columns")
            columns = load_columns(described[0]) if described else None
            opened = open_disdrometer_files(tables, columns)
            measured = tuple(each.measured() for each in opened)
            try:
                return measured, calibrate_files(opened, name=tables[0].name.partition(".")[0], force=force)
            except ValueError as error:
                return measured, error

        def take(result: "tuple[Sequence[MeasurementSummary], FittedCalibration | ValueError]") -> str:
            from ..disdrometer.fit import RatesDisagreeError

            self.measured, fitted = result
            if isinstance(fitted, ValueError):
                self.disagreeing = tuple(files) if isinstance(fitted, RatesDisagreeError) else ()
                raise fitted
            self.fitted = fitted
            return f"{fitted.records_used:,} of {fitted.records:,} records fitted in {len(fitted.rows)} rows"

        if self.busy is None:
            self.measured, self.disagreeing = (), ()
        self._begin(f"Fit {files[0].name}", fit, take)

    def read_series(self, path: Path) -> None:
        """Read a disdrometer file whose rates are to become the weather."""

        def read() -> "DisdrometerReading":
            from ..disdrometer.open import read_disdrometer

            return read_disdrometer(path)

        def take(reading: "DisdrometerReading") -> str:
            self.series = MeasuredSeries(path.name, reading)
            return "Read; choose how it becomes rain keyframes"

        self._begin(f"Read {path.name}", read, take)

    def add_file(self, path: str) -> None:
        """Add a calibration file to the choices."""
        if path not in self.calibrations:
            self.files.append(path)

    def use(self, name: str) -> None:
        """Use another calibration for the rain, by name or file."""
        if self._load(name) is not None:
            self.add_file(name)
            self._document.change_rain("Calibration", calibration=name)

    def compare(self, name: str) -> None:
        """Display another calibration next to the rain's own."""
        if (calibration := self._load(name)) is not None:
            self.pass_file, self.compared = calibration, name

    def use_fitted(self) -> None:
        """Save the last fit among the user's calibrations, and use it for the rain."""
        assert self.fitted is not None, "fit before using it"
        folder = platformdirs.user_data_path("gsrain", appauthor=False) / "calibrations"
        path = folder / f"{self.fitted.calibration.name}.yaml"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            save_calibration(self.fitted.calibration, path)
        except OSError as error:
            self._status.report(error, "The calibration can't be saved")
        else:
            self.use(str(path))

    def _load(self, name: str) -> Calibration | None:
        try:
            return load_calibration(name)
        except (ValueError, OSError) as error:
            self._status.report(error)
            return None

    def _begin(self, title: str, work: Callable[[], _Result], take: Callable[[_Result], str]) -> None:
        """Start a measurement unless another one runs; `take` processes its result and describes it, or raises."""

        def run() -> Generator[Progress, None, _Result]:
            yield Progress(0.0, title)
            return work()

        if self.busy is None:
            job = Job[_Result]("calibration", title, run, in_thread=True, ends_with_scene=False)
            self.job = self._jobs.start(job, lambda result, _: take(result))
