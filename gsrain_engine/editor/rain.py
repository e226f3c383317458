"""What the rain panels measure, in a thread: the virtual disdrometer, and calibrations fitted to disdrometer files."""

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
"""The virtual disdrometer hands over a spectrum a minute, as real ones do."""


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
    """Why there is no fit."""
    disagreeing: tuple[Path, ...]


class CalibrationTools:
    """One measurement at a time. Call everything on the main thread, and `poll` once a frame."""

    def __init__(self) -> None:
        self.counted: DisdrometerMeasurement | None = None
        """What the virtual disdrometer counted last."""
        self.fitted: FittedCalibration | None = None
        """The last fit."""
        self.measured: tuple[MeasurementSummary, ...] = ()
        """Summaries of the files of the last fit, also where it failed."""
        self.disagreeing: tuple[Path, ...] = ()
        """Files whose drops don't give the instrument's own rate, and that were not fitted for that."""
        self.area_m2, self.seconds = 0.5, 60.0
        """Of the next virtual measurement; seconds are simulated ones."""
        self.compared = "published"
        """Name or file of the calibration that is shown beside the rain's own."""
        self.pass_file = load_calibration(self.compared)
        """That calibration."""
        self.files: list[str] = []
        """Calibration files that were opened or written here."""
        self.series: tuple[str, DisdrometerReading] | None = None
        """A disdrometer file that is about to become the weather: its name and what is in it."""
        self.problem: str | None = None
        """Why the last measurement failed, in one sentence."""
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="rain lab")
        self._task: _MeasurementTask | None = None

    @property
    def calibrations(self) -> list[str]:
        """Names and files to choose from."""
        return [*calibration_names(), *self.files]

    @property
    def busy(self) -> str | None:
        """What is being measured; None when nothing is."""
        return None if self._task is None else self._task.label

    def compare_with(self, name: str) -> None:
        """Show another calibration beside the rain's own. Raises `ValueError`, `OSError`."""
        self.pass_file, self.compared = load_calibration(name), name

    def measure(self, rain: RainSettings) -> None:
        """Hold a virtual disdrometer into the rain, from time 0 on."""
        area_m2, seconds = self.area_m2, self.seconds

        def count() -> "DisdrometerMeasurement":
            from ..disdrometer.virtual import VirtualDisdrometer

            times = np.append(np.arange(max(1, np.ceil(seconds / RECORD_S))) * RECORD_S, seconds)
            return VirtualDisdrometer(RainSimulation.start(rain), area_m2).measure(times)

        self._begin(f"Counting drops for {seconds:g} s", count, lambda counted: setattr(self, "counted", counted))

    def fit(self, files: Sequence[Path], force: bool = False) -> None:
        """Fit a calibration to disdrometer files of one instrument; by `force` even where rates disagree.

        A YAML file among them says which column of their tables is what.
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
        """Write the last fit among the person's own calibrations; returns the file's path. Raises `OSError`."""
        assert self.fitted is not None, "fit before keeping"
        folder = platformdirs.user_data_path("gsrain", appauthor=False) / "calibrations"
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{self.fitted.calibration.name}.yaml"
        save_calibration(self.fitted.calibration, path)
        self.add_file(str(path))
        return str(path)

    def add_file(self, path: str) -> None:
        """List a calibration file among those to choose from."""
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


# § Which calibration a document's rain follows; what is wrong with one is kept in `document.problem`.


def use_calibration(document: EditedDocument, lab: CalibrationTools, name: str) -> None:
    """Let the rain follow another calibration, by name or file."""
    try:
        load_calibration(name)
    except (ValueError, OSError) as error:
        document.problem = str(error)
        logger.error("%s", error)
    else:
        lab.add_file(name)
        document.change_rain("Calibration", calibration=name)


def compare_calibration(document: EditedDocument, lab: CalibrationTools, name: str) -> None:
    """Show another calibration beside the rain's own."""
    try:
        lab.compare_with(name)
    except (ValueError, OSError) as error:
        document.problem = str(error)
        logger.error("%s", error)


def use_fitted_calibration(document: EditedDocument, lab: CalibrationTools) -> None:
    """Keep the lab's last fit in a file, and let the rain follow it."""
    try:
        path = lab.keep_fitted()
    except OSError as error:
        document.problem = describe_error("The calibration can't be saved", error)
    else:
        use_calibration(document, lab, path)


# § Roofs found before a frame needs them: the search takes seconds, so it goes on beside the window.


class ShelterMapBuilder:
    """Searches one scene after the other; what it finds is kept where `shelter_map_of` keeps it."""

    def __init__(self, thread: ThreadPoolExecutor) -> None:
        """Search in a thread."""
        self._thread = thread
        self._scene: Scene | None = None
        self._search: Future[ShelterMap | None] | None = None

    def knows(self, scene: Scene) -> bool:
        """Say whether asking for the roofs of a scene takes no time."""
        return self._search is not None and self._search.done() and self._is_of(scene)

    @property
    def pending(self) -> list[Future[ShelterMap | None]]:
        """The search, to wait for where there are no frames to wait with."""
        return [] if self._search is None else [self._search]

    def look_at(self, scene: Scene) -> None:
        """Search a scene once the search before is through; a scene that is known already isn't searched again."""
        waits = self._search is not None and not self._search.done()
        if not waits and not self._is_of(scene):
            self._scene, self._search = scene, self._thread.submit(shelter_map_of, scene)

    def _is_of(self, scene: Scene) -> bool:
        return self._scene is not None and self._scene.geometry_key == scene.geometry_key


# § What the Shower panel remembers from frame to frame; not part of the document.

_MIN_SPAN_S = 10.0

_TOPS_MM_H = (15.0, 30.0, 60.0, 105.0)
"""Upper ends of the axis: it does not run away from a point that is being dragged."""


class PendingInput(NamedTuple):
    """A number that is being typed; it counts when its field is left."""

    time_s: float
    field: str
    value: float


@dataclass(slots=True)
class KeyframePanelState:
    """The part of the curve that is seen, and what is held."""

    refit: bool = True
    """Show all keys in the next frame."""
    top_mm_h: float = _TOPS_MM_H[0]
    is_held: bool = False
    """Whether a key is being dragged; the axis waits until it is let go."""
    typed: PendingInput | None = None
    speed_up: float = 1.0
    """Of the series that is about to be taken."""
    start_s: float = 0.0
    """Where that series begins."""

    def follow(self, weather: RainKeyframes, heaviest_mm_h: float) -> None:
        """Let the axis fit the heaviest rain, unless a key is held."""
        if not self.is_held:
            self.top_mm_h = next(top for top in _TOPS_MM_H if 1.05 * heaviest_mm_h <= top)

    @staticmethod
    def span_s(weather: RainKeyframes, now_s: float) -> tuple[float, float]:
        """From when to when to show: all keys with a margin, or a minute from now without any."""
        times = [key.time_s for key in (*weather.keys[:1], *weather.keys[-1:])] or [now_s, now_s + 60.0]
        first, last = min(times), max(times)
        span = max(last - first, _MIN_SPAN_S)
        return first - 0.06 * span, first + 1.06 * span
