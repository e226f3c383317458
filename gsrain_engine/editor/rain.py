"""Tools of the rain panels: virtual disdrometer, calibration fits, shelter maps, and keyframe panel state."""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
import platformdirs

from ..rain.calibration import calibration_names, load_calibration, save_calibration
from ..rain.keyframes import RainKeyframes
from ..rain.settings import RainSettings
from ..rain.shelter_map import ShelterMap, shelter_map_of
from ..rain.simulation import RainSimulation
from ..scene.scene import Scene
from .document import EditedDocument
from .notifications import describe_error

if TYPE_CHECKING:
    from ..disdrometer.file_summary import MeasurementSummary
    from ..disdrometer.fit_models import FittedCalibration
    from ..disdrometer.measurement import DisdrometerMeasurement
    from ..disdrometer.spectra import DisdrometerReading

logger = logging.getLogger("gsrain")
RECORD_S = 60.0
"""Interval of virtual spectra: one minute, as real disdrometers report."""


@dataclass(slots=True)
class _MeasurementTask:
    label: str
    result: Future[Any]
    take: Callable[[Any], None]


@dataclass(frozen=True, slots=True)
class _FitInput:
    measured: "tuple[MeasurementSummary, ...]"
    fitted: "FittedCalibration | None"
    problem: str | None
    """Reason why there is no fit."""
    disagreeing: tuple[Path, ...]


class CalibrationTools:
    """One measurement at a time. Main thread only; call `poll` once a frame."""

    def __init__(self) -> None:
        self.counted: DisdrometerMeasurement | None = None
        """Last measurement of the virtual disdrometer."""
        self.fitted: FittedCalibration | None = None
        self.measured: tuple[MeasurementSummary, ...] = ()
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
        """Calibration files opened or written in this session."""
        self.series: tuple[str, DisdrometerReading] | None = None
        """Name and content of a disdrometer file about to be imported as weather."""
        self.problem: str | None = None
        """Reason why the last measurement failed, in one sentence."""
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="rain lab")
        self._task: _MeasurementTask | None = None

    @property
    def calibrations(self) -> list[str]:
        return [*calibration_names(), *self.files]

    @property
    def busy(self) -> str | None:
        """Description of the measurement in progress, or None."""
        return None if self._task is None else self._task.label

    def compare_with(self, name: str) -> None:
        """Show another calibration next to the rain's own. Raises `ValueError`, `OSError`."""
        self.pass_file, self.compared = load_calibration(name), name

    def measure(self, rain: RainSettings) -> None:
        """Measure the rain with a virtual disdrometer, from time 0 on."""
        area_m2, seconds = self.area_m2, self.seconds

        def count() -> "DisdrometerMeasurement":
            from ..disdrometer.virtual import VirtualDisdrometer

            times = np.append(np.arange(max(1, np.ceil(seconds / RECORD_S))) * RECORD_S, seconds)
            return VirtualDisdrometer(RainSimulation.start(rain), area_m2).measure(times)

        self._begin(f"Counting drops for {seconds:g} s", count, lambda counted: setattr(self, "counted", counted))

    def fit(self, files: Sequence[Path], force: bool = False) -> None:
        """Fit a calibration to disdrometer files of one instrument; `force` accepts disagreeing rates.

        A YAML file among them describes the columns of their tables.
        """
        described = [path for path in files if path.suffix in (".yaml", ".yml")]
        tables = tuple(path for path in files if path not in described)

        def fitted() -> "_FitInput":
            from ..disdrometer.file_summary import open_disdrometer_file
            from ..disdrometer.fit import RatesDisagreeError, calibrate_files
            from ..disdrometer.tables import load_columns

            if not tables or len(described) > 1:
                raise ValueError("choose disdrometer files, and at most one YAML file that describes their columns")
            columns = load_columns(described[0]) if described else None
            opened = [open_disdrometer_file(path, columns) for path in tables]
            measured = tuple(each.measured() for each in opened)
            try:
                result = calibrate_files(opened, name=tables[0].name.partition(".")[0], force=force)
            except RatesDisagreeError as error:
                return _FitInput(measured, None, str(error), tuple(files))
            except ValueError as error:
                return _FitInput(measured, None, str(error), ())
            return _FitInput(measured, result, None, ())

        if self._task is None:
            self.measured, self.disagreeing = (), ()
        self._begin(f"Fitting {files[0].name}", fitted, self._take_fit)

    def _take_fit(self, fit: "_FitInput") -> None:
        self.measured, self.disagreeing = fit.measured, fit.disagreeing
        if fit.fitted is None:
            raise ValueError(fit.problem)
        self.fitted = fit.fitted

    def read_series(self, path: Path) -> None:
        """Read a disdrometer file whose rates are to become the weather."""

        def read() -> "DisdrometerReading":
            from ..disdrometer.open import read_disdrometer

            return read_disdrometer(path)

        self._begin(f"Reading {path.name}", read, lambda reading: setattr(self, "series", (path.name, reading)))

    def keep_fitted(self) -> str:
        """Save the last fit among the user's calibrations; return the file's path. Raises `OSError`."""
        assert self.fitted is not None, "fit before keeping"
        folder = platformdirs.user_data_path("gsrain", appauthor=False) / "calibrations"
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{self.fitted.calibration.name}.yaml"
        save_calibration(self.fitted.calibration, path)
        self.add_file(str(path))
        return str(path)

    def add_file(self, path: str) -> None:
        """Add a calibration file to the choices."""
        if path not in self.calibrations:
            self.files.append(path)

    def poll(self) -> None:
        if self._task is None or not self._task.result.done():
            return
        task, self._task = self._task, None
        try:
            task.take(task.result.result())
        except (ValueError, OSError, MemoryError, msgspec.MsgspecError) as error:
            self.problem = str(error)
            logger.error("%s: %s", task.label, error)
        else:
            logger.info("%s: done", task.label)

    def close(self) -> None:
        self._thread.shutdown(cancel_futures=True)

    def _begin(self, label: str, work: Callable[[], Any], take: Callable[[Any], None]) -> None:
        if self._task is None:
            self.problem = None
            self._task = _MeasurementTask(label, self._thread.submit(work), take)


# Calibrations; errors are set as `document.problem`


def use_calibration(document: EditedDocument, lab: CalibrationTools, name: str) -> None:
    """Use another calibration for the rain, by name or file."""
    try:
        load_calibration(name)
    except (ValueError, OSError) as error:
        document.problem = str(error)
        logger.error("%s", error)
    else:
        lab.add_file(name)
        document.change_rain("Calibration", calibration=name)


def compare_calibration(document: EditedDocument, lab: CalibrationTools, name: str) -> None:
    """Show another calibration next to the rain's own."""
    try:
        lab.compare_with(name)
    except (ValueError, OSError) as error:
        document.problem = str(error)
        logger.error("%s", error)


def use_fitted_calibration(document: EditedDocument, lab: CalibrationTools) -> None:
    """Save the last fit to a file and use it for the rain."""
    try:
        path = lab.keep_fitted()
    except OSError as error:
        document.problem = describe_error("The calibration can't be saved", error)
    else:
        use_calibration(document, lab, path)


# Shelter maps, computed in the background because a search takes seconds


class ShelterMapBuilder:
    """Computes shelter maps of one scene after another; results are in the cache of `shelter_map_of`."""

    def __init__(self, thread: ThreadPoolExecutor) -> None:
        self._thread = thread
        self._scene: Scene | None = None
        self._search: Future[ShelterMap | None] | None = None

    def knows(self, scene: Scene) -> bool:
        """Return whether the roofs of a scene are already known."""
        return self._search is not None and self._search.done() and self._is_of(scene)

    @property
    def pending(self) -> list[Future[ShelterMap | None]]:
        """The search in progress, to wait for where there are no frames."""
        return [] if self._search is None else [self._search]

    def look_at(self, scene: Scene) -> None:
        """Start to search a scene, unless it is known or another search is running."""
        waits = self._search is not None and not self._search.done()
        if not waits and not self._is_of(scene):
            self._scene, self._search = scene, self._thread.submit(shelter_map_of, scene)

    def _is_of(self, scene: Scene) -> bool:
        return self._scene is not None and self._scene.geometry_key == scene.geometry_key


# State of the Rain keyframes panel; not part of the document

_MIN_SPAN_S = 10.0
_TOPS_MM_H = (15.0, 30.0, 60.0, 105.0)
"""Upper ends of the axis in steps, so that it does not move while a point is dragged."""


class PendingInput(NamedTuple):
    """A number being typed; it is applied when its field loses the focus."""

    time_s: float
    field: str
    value: float


@dataclass(slots=True)
class KeyframePanelState:
    """Visible part of the curve, and the running interaction."""

    refit: bool = True
    """Show all keyframes in the next frame."""
    top_mm_h: float = _TOPS_MM_H[0]
    is_held: bool = False
    """True while a keyframe is dragged; the axis changes only afterwards."""
    typed: PendingInput | None = None
    speed_up: float = 1.0
    """Speed factor of the series to be imported."""
    start_s: float = 0.0

    def follow(self, weather: RainKeyframes, heaviest_mm_h: float) -> None:
        """Fit the axis to the heaviest rain, unless a keyframe is being dragged."""
        if not self.is_held:
            self.top_mm_h = next(top for top in _TOPS_MM_H if 1.05 * heaviest_mm_h <= top)

    @staticmethod
    def span_s(weather: RainKeyframes, now_s: float) -> tuple[float, float]:
        """Time span to show: all keyframes with a margin, or one minute from now if there are none."""
        times = [key.time_s for key in (*weather.keys[:1], *weather.keys[-1:])] or [now_s, now_s + 60.0]
        first, last = min(times), max(times)
        span = max(last - first, _MIN_SPAN_S)
        return first - 0.06 * span, first + 1.06 * span
