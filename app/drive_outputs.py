"""Output files of `gsrain drive`: runs, tables, figures, videos and a report."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import msgspec

from gsrain_engine.evaluation.report import write_report
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.scene.files import file_word, shortened, whole_file
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.ground import recorded_route
from gsrain_engine.simulation.metrics.summary import ScoredRun, compare_drives, results_table, write_metrics_csv
from gsrain_engine.simulation.playback import RolloutPlayback
from gsrain_engine.simulation.rollout import Rollout
from gsrain_engine.simulation.rollout_io import write_rollout
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.simulation.video import RolloutVideo, render_rollout_video

from .progress import progress_bar

EXPORTS = {"parquet": "pyarrow", "mcap": "mcap", "xosc": "scenariogeneration"}
"""Other formats of a run, and the package that writes each."""

_WORD_BYTES = 90  # maximum length of a scenario's and of an agent's name within a file name


@dataclass(frozen=True, slots=True)
class DriveFiles:
    """Output folder and chosen files of a command."""

    folder: Path
    exports: frozenset[str]
    fps: float

    def check(self) -> None:
        """Raise ValueError for unknown formats, missing packages and frame rates out of bounds."""
        unknown = sorted(self.exports - set(EXPORTS))
        if unknown:
            raise ValueError(f"--export {unknown[0]}: there is only {', '.join(EXPORTS)}")
        for name in sorted(self.exports):
            if find_spec(EXPORTS[name]) is None:
                raise ValueError(f"--export {name} needs {EXPORTS[name]}: pip install 'gsrain[drive]'")
        if not 1 <= self.fps <= 60:
            raise ValueError(f"--fps {self.fps:g}: must be within 1..60")

    def of(self, run: ScoredRun, suffix: str) -> Path:
        metrics = run.metrics
        return self._of(metrics.scenario, metrics.agent, metrics.intensity_mm_h, metrics.seed, suffix)

    def figure(self, scenario: str, agent: str) -> Path:
        return self.folder / f"{_drive_word(scenario, agent)}.png"

    def planned(
        self, scenario: str, agents: Sequence[str], rains_mm_h: Sequence[float], seed: int, *, films: bool
    ) -> list[Path]:
        """Return all files that runs of these agents in these rains will write."""
        suffixes = [".jsonl", *(f".{kind}" for kind in sorted(self.exports))]
        suffixes += [".xodr"] * ("xosc" in self.exports) + [".mp4"] * films
        runs = [
            self._of(scenario, agent, rain, seed, suffix)
            for agent in agents
            for rain in rains_mm_h
            for suffix in suffixes
        ]
        figures = [self.figure(scenario, agent) for agent in agents]
        return [self.folder / name for name in ("report.html", "table.md", "table.csv")] + figures + runs

    def _of(self, scenario: str, agent: str, intensity_mm_h: float, seed: int, suffix: str) -> Path:
        return self.folder / f"{_drive_word(scenario, agent)}_{intensity_mm_h:g}mm_seed{seed}{suffix}"


def _drive_word(scenario: str, agent: str) -> str:
    """Return the common start of the file names of an agent in a scenario; long names are shortened separately."""
    return file_word(f"{shortened(scenario, _WORD_BYTES)}_{shortened(agent, _WORD_BYTES)}", 2 * _WORD_BYTES + 1)


def write_drives(
    files: DriveFiles,
    runs: Sequence[ScoredRun],
    scene: Scene,
    renderer: Renderer | None,
    settings: Mapping[str, object],
) -> list[str]:
    """Write all outputs of runs in one scene, with videos if there is a renderer. Returns the files' names.

    `settings` are listed in the report in addition to those in the runs.
    """
    # Matplotlib loads slowly: import it only after the first drive.
    from gsrain_engine.simulation.metrics.figures import kinematics_figure, write_figure
    from gsrain_engine.simulation.metrics.report import drive_report_page

    files.folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for run in runs:
        written += _write_run(files, run, scene, renderer)
    compared = compare_drives(runs)
    table = results_table(compared)
    with whole_file(files.folder / "table.md") as beside:
        beside.write_text(table.markdown, encoding="utf-8")
    write_metrics_csv(files.folder / "table.csv", [run.metrics for run in runs])
    figures = {files.figure(each.scenario, each.agent): kinematics_figure(each) for each in compared}
    for path, figure in figures.items():
        write_figure(path, figure)
    write_report(files.folder / "report.html", drive_report_page(runs, {scene.name: recorded_route(scene)}, settings))
    told = [files.folder / "report.html", files.folder / "table.md", files.folder / "table.csv", *figures]
    return [path.name for path in (*told, *written)]


def _write_run(files: DriveFiles, run: ScoredRun, scene: Scene, renderer: Renderer | None) -> list[Path]:
    rollout = run.rollout
    assert rollout is not None
    jsonl = files.of(run, ".jsonl")
    write_rollout(jsonl, rollout)
    written = [jsonl]
    for kind in sorted(files.exports):
        _EXPORTERS[kind](files.of(run, f".{kind}"), rollout, scene)
        written.append(files.of(run, f".{kind}"))
    if "xosc" in files.exports:  # the road file that it refers to
        written.append(files.of(run, ".xodr"))
    if renderer is not None:
        film = files.of(run, ".mp4")
        _video(film, RolloutVideo(RolloutPlayback(rollout, scene), renderer), files.fps)
        written.append(film)
    return written


def _video(path: Path, video: RolloutVideo, fps: float) -> None:
    with progress_bar("Filming", len(video.times(fps)), draws=True) as advance:
        for _ in render_rollout_video(path, video, fps):
            advance()


def _write_parquet(path: Path, rollout: Rollout, scene: Scene) -> None:
    from gsrain_engine.simulation.rollout_io import write_rollout_parquet

    write_rollout_parquet(path, rollout)


def _write_mcap(path: Path, rollout: Rollout, scene: Scene) -> None:
    from gsrain_engine.simulation.interop.mcap import write_rollout_mcap

    write_rollout_mcap(path, rollout, recorded_route(scene))


def _write_xosc(path: Path, rollout: Rollout, scene: Scene) -> None:
    from gsrain_engine.simulation.interop.openscenario_write import write_openscenario

    write_openscenario(path, msgspec.convert(rollout.scenario, Scenario), scene)


_EXPORTERS: Mapping[str, Callable[[Path, Rollout, Scene], None]] = {
    "parquet": _write_parquet,
    "mcap": _write_mcap,
    "xosc": _write_xosc,
}
