"""`gsrain drive [SCENARIO.yaml]`: closed-loop simulation of scene, rain and agent, and its output files."""

import traceback
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
from cyclopts import Parameter

from gsrain_engine.choices import Backend
from gsrain_engine.plugins import DRIVE_EXPORTS, find_extensions
from gsrain_engine.rain.available import check_available
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.render import export_settings
from gsrain_engine.render.export_settings import Lod
from gsrain_engine.report.numbers import provenance_lines, run_provenance, write_provenance, write_text
from gsrain_engine.safe_io.file_names import file_word, shortened
from gsrain_engine.simulation.agents.options import HUGSIM, SHIPPED_AGENTS, AgentOptions
from gsrain_engine.simulation.scenario_settings import Scenario
from gsrain_engine.simulation.vehicle_settings import BACKGROUND

from .console import print, print_lines, progress_bar
from .options import (
    BACKEND,
    JsonFile,
    Preset,
    StructOptions,
    Wet,
    check_within,
    flag,
    option,
    options_of,
    parse_intensities,
    setting,
    split_words,
    takes_set,
)
from .outputs import check_writable, lock_outputs, write_numbers
from .render import rainy_light

if TYPE_CHECKING:
    from gsrain_engine.render.provenance import PictureProvenance
    from gsrain_engine.render.renderer import Renderer
    from gsrain_engine.scene.scene import Scene
    from gsrain_engine.simulation.agents.base import Agent
    from gsrain_engine.simulation.drive_exports import DriveExport
    from gsrain_engine.simulation.metrics.summary import ScoredRun
    from gsrain_engine.simulation.rollout import Rollout
    from gsrain_engine.simulation.simulation import Simulation

EXPORTS = ("parquet", *(each.name for each in find_extensions(DRIVE_EXPORTS)))

# Agents


@dataclass(frozen=True, kw_only=True)
class ChosenAgents:
    """Choice of agents, listed before their options."""

    agent: Annotated[
        list[str] | None,
        flag(
            f"Agent that drives: {', '.join(SHIPPED_AGENTS)}, hugsim, or one of an installed package (entry points "
            "gsrain.agents); FILE.py or FILE.py:NAME is a class of your own. "
            "May be given several times. Default: camera-idm if a detector is found, else oracle-idm.",
            "Driver",
        ),
    ] = None


@Parameter(name="*")  # fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class DriverOptions(options_of(AgentOptions, "drive", topic="Driver"), ChosenAgents):
    """Options about agents."""

    hugsim_dir: Annotated[
        Path | None, option("Folder with the pipes of HUGSIM's protocol: UniAD, VAD or LTF drives.", topic="Driver")
    ] = None
    hugsim_client: Annotated[
        str | None,
        flag(
            "Command of the client, started before the scene is read; without one, start it yourself on the folder.",
            "Driver",
            rare=True,
        ),
    ] = None
    hugsim_wait: Annotated[
        float,
        option(
            "Seconds to wait for the client's first plan; at most 60 of them for each later one.",
            topic="Driver",
            rare=True,
        ),
    ] = 120.0
    hugsim_all: Annotated[
        bool, flag("Send the client depth and semantic classes too, which takes longer.", "Driver", rare=True)
    ] = False
    channel_order: Annotated[
        Literal["rgb", "bgr"], option("Of the images in HUGSIM's protocol.", topic="Driver", rare=True)
    ] = "rgb"

    def names(self) -> list[str]:
        """Return the names of the chosen agents. Raises ValueError for unknown or contradictory ones."""
        from gsrain_engine.simulation.agents.registry import agent_file, agent_names

        asked = list(dict.fromkeys(self.agent or []))
        if self.hugsim_dir is not None and asked not in ([], [HUGSIM]):
            raise ValueError("--hugsim-dir is for the agent hugsim alone; leave out --agent")
        check_within("--hugsim-wait", self.hugsim_wait, 0, 86_400, "s", is_open=True)
        known = (*agent_names(), HUGSIM)
        unknown = next((name for name in asked if name not in known and agent_file(name) is None), None)
        if unknown is not None:
            raise ValueError(f"--agent {unknown}: there is only {', '.join(known)}, or a file FILE.py")
        return [HUGSIM] if self.hugsim_dir is not None else asked

    def fitted(self, scenario: Scenario, scene: "Scene") -> "tuple[Scenario, Scene]":
        """Return scenario and scene with the rig and vehicle that HUGSIM's clients expect, if one is used."""
        if self.hugsim_dir is None:
            return scenario, scene
        from gsrain_engine.simulation.interop.hugsim_protocol import with_hugsim_rig

        return with_hugsim_rig(scenario, scene)

    @contextmanager
    def opened(self) -> "Generator[list[Agent]]":
        """Open all agents for the duration of the block; prints why a default agent was substituted."""
        from gsrain_engine.simulation.agents.registry import default_agent, open_agent

        options = self.settings()
        names = self.names()
        if not names:
            name, reason = default_agent(options)
            names = [name]
            if reason is not None:
                print(reason)
        with ExitStack() as stack:
            agents: list[Agent] = []
            for name in names:
                agents.append(self._hugsim() if name == HUGSIM else open_agent(name, options))
                stack.callback(agents[-1].close)
            yield agents

    def _hugsim(self) -> "Agent":
        """Open the agent of HUGSIM's protocol and start its client. Raises ClientError if the client ends at once."""
        if self.hugsim_dir is None:
            raise ValueError("--agent hugsim takes the folder of its pipes: --hugsim-dir DIR")
        from gsrain_engine.simulation.interop.hugsim_agent import LATER_WAIT_S, HugsimAgent

        agent = HugsimAgent(
            self.hugsim_dir, self.hugsim_client, self.channel_order, semantic=self.hugsim_all, depth=self.hugsim_all,
            first_wait_s=self.hugsim_wait, later_wait_s=min(self.hugsim_wait, LATER_WAIT_S),
        )  # fmt: skip
        agent.start()
        return agent


RunOptions = options_of(Scenario, "drive", "Default: the scenario's.", topic="Scenario")
WeatherOptions = options_of(
    RainSettings, "drive", "Default: the scenario's.", topic="Rain", fixed={"intensity_mm_h": "--rain"}
)


@takes_set
def drive(
    scenario: Annotated[
        str | None,
        option(
            "A shipped scenario by name or a file: ours, HUGSIM's YAML or OpenSCENARIO; default: stationary-lead.",
            "SCENARIO.yaml",
        ),
    ] = None,
    /,
    *,
    driver: DriverOptions | None = None,
    rain: Annotated[
        str | None, setting(RainSettings, "intensity_mm_h", "Several with commas. Default: the scenario's.", "Rain")
    ] = None,
    weather: WeatherOptions | None = None,
    preset: Preset = None,
    run: RunOptions | None = None,
    wet: Wet = None,
    output: Annotated[
        Path | None, option("Output folder; default: drive-NAME.", "--output", "-o", topic="Output")
    ] = None,
    video: Annotated[
        bool | None, option("Write a video of each run; default: if there is only one.", topic="Output")
    ] = None,
    fps: Annotated[float, option("Frame rate of the videos.", topic="Output", rare=True)] = 10.0,
    export: Annotated[
        str,
        option(f"Also write runs as {', '.join(EXPORTS)}, with commas.", topic="Output"),
    ] = "",
    rerun: Annotated[
        Path | None,
        option(
            "Also write a Rerun recording (.rrd): scene, boxes, plan, plots, camera. One run only.",
            topic="Output",
            rare=True,
        ),
    ] = None,
    lod: Annotated[Lod | None, setting(export_settings.ExportSettings, "lod", topic="More", rare=True)] = None,
    backend: Annotated[Backend, BACKEND] = "auto",
    json: JsonFile = None,
) -> None:
    """Test a driver in the rain: an agent sees the scene and plans, and the vehicle follows its plan.

    A folder gets each run as JSON lines (which the window opens), a table like the paper's, figures over time, a report
    and a video. Without SCENARIO.yaml a car is stationary in the lane of the built-in street.
    """
    from gsrain_engine.backends import open_renderer
    from gsrain_engine.rain.properties import extinction_note
    from gsrain_engine.rain.wetness import with_wet_choice
    from gsrain_engine.render.level_of_detail import lod_cut
    from gsrain_engine.render.video import can_write_videos
    from gsrain_engine.scene.open import load_sorted_scene, scene_hash, with_lod_trees
    from gsrain_engine.simulation.drive_exports import find_drive_export
    from gsrain_engine.simulation.metrics.summary import ScoredRun, compare_drives, results_table
    from gsrain_engine.simulation.obstacles import drivable_of
    from gsrain_engine.simulation.scenario_io import load_scenario
    from gsrain_engine.simulation.simulation import Simulation
    from gsrain_engine.sweep.expansion import software

    options = driver or DriverOptions()
    loaded = load_scenario(scenario or "stationary-lead")
    test: Scenario = (run or RunOptions()).settings(loaded)
    if test.scene == loaded.scene:
        _check_scene(test.scene, scenario)
    rains = _rains(test.rain, rain, preset, weather or WeatherOptions())
    folder = output or Path(f"drive-{file_word(test.name)}")
    exports = {name: find_drive_export(name, f"--export {name}") for name in sorted({*split_words(export)})}
    files = DriveFiles(folder, exports, fps)
    files.check()
    if rerun is not None and rerun.suffix.lower() != ".rrd":
        raise ValueError(f"--rerun {rerun}: expected the name of a Rerun recording (.rrd)")
    check_writable(json, rerun, folders=[folder])
    recording = None if rerun is None else find_drive_export("rerun", "--rerun")
    lock_outputs(folder, *([] if rerun is None else [rerun]))
    with ExitStack() as stack:
        agents = stack.enter_context(options.opened())  # before the scene, which takes longer to read
        hashed = scene_hash(test.scene)
        opened = load_sorted_scene(test.scene)
        heaviest = max(rains, key=lambda each: each.intensity_mm_h)
        opened, _ = rainy_light(opened, heaviest, wet, heaviest.intensity_mm_h)
        rains = [with_wet_choice(each, wet) for each in rains]
        test, opened = options.fitted(test, opened)
        can_film = can_write_videos() and bool(opened.rigs)
        films = video if video is not None else len(agents) * len(rains) == 1 and can_film
        if films and not opened.rigs:
            raise ValueError(f"--video: scene {opened.name!r} has no rig whose front camera could film")
        if rerun is not None and len(agents) * len(rains) > 1:
            raise ValueError(f"--rerun {rerun}: holds one run, not {len(agents)} agents in {len(rains)} rains")
        names, rains_mm_h = [each.name for each in agents], [each.intensity_mm_h for each in rains]
        doubled = next((name for name in names if names.count(name) > 1), None)
        if doubled is not None:
            raise ValueError(f"--agent: two agents are called {doubled!r}, and so would be their files")
        check_writable(json, *files.planned(test.name, names, rains_mm_h, rains[0].seed, films=films))
        renderer = None
        with_images = [each for each in (*exports.values(), recording) if each is not None and each.cameras != "none"]
        records = bool(with_images and opened.rigs)
        if films or records or any(agent.needs.cameras for agent in agents):
            opened = opened if lod_cut(opened, lod) is None else with_lod_trees(opened)
            renderer = stack.enter_context(open_renderer(backend))
        runs: list[ScoredRun] = []
        pictures: dict[str, PictureProvenance] = {}
        problem: str | None = None
        extinction = extinction_note(rains)
        for agent, each in product(agents, rains):
            simulation = Simulation(msgspec.structs.replace(test, rain=each), opened, agent.needs, renderer, lod=lod)
            problem = _drive(simulation, agent)
            seen = simulation.pictures.items()
            pictures |= {f"{agent.name}, {each.intensity_mm_h:g} mm/h, {name}": first for name, first in seen}
            rollout = msgspec.structs.replace(simulation.rollout(agent.name), scene_hash=hashed, software=software())
            if problem is not None and rollout.steps[-1].step == 0:  # no step was driven: nothing to score or to draw
                break
            drivable = drivable_of(simulation.scene, simulation.ground, simulation.occupied)
            runs.append(ScoredRun.of(rollout, simulation.occupied, drivable))
            if problem is not None:  # results so far are written anyway
                break
        if not runs:
            raise ValueError(problem)
        facts = provenance_lines(run_provenance({}))  # the runs name their scene
        facts |= {"rain": extinction} if extinction else {}
        written = write_drives(files, runs, opened, renderer, facts, lod, pictures, films=films)
        if rerun is not None and recording is not None:
            _export(recording, rerun, runs[0].rollout, opened, renderer if opened.rigs else None, lod)
    print_lines(results_table(compare_drives(runs)).text)
    if extinction:
        print(extinction)
    if len(rains) > 1 and test.friction == "dry":
        for name in [agent.name for agent in agents if not agent.needs.cameras]:
            print(f"{name} uses no camera: rain changes nothing for it.")
    if any(len(run.rollout.steps) == 1 and run.rollout.steps[0].collision == BACKGROUND for run in runs if run.rollout):
        print(
            f"The drive begins inside of an obstacle of scene {opened.name!r}: is its unit of length right, and the "
            "start free? `ahead_m` of the scenario moves it along."
        )
    print(f"{folder}:")
    for name in written:
        print(f"  {name}")
    if rerun is not None:
        print(f"{rerun}: opens with rerun {rerun}")
    rows = [msgspec.to_builtins(run.metrics) for run in runs]
    write_numbers(json, {**rows[0], "rows": rows} if len(rows) == 1 else {"rows": rows})
    if problem is not None:
        raise ValueError(problem)


def _check_scene(scene: str, scenario: str | None) -> None:
    """Raise ValueError with the folders searched if the scene of a scenario file is not there."""
    from gsrain_engine.scene.built_in import DEFAULT_SCENE

    if scenario is None or scene == DEFAULT_SCENE or Path(scene).exists() or not Path(scenario).is_file():
        return
    folders = dict.fromkeys([Path(scenario).absolute().parent, Path.cwd()])
    places = " nor at ".join(str(folder / scene) for folder in folders)
    raise ValueError(
        f"{scenario}: its scene {scene} is {'neither' if len(folders) > 1 else 'not'} at {places}; put it there, or "
        "name it by --scene SCENE"
    )


def _drive(simulation: "Simulation", agent: "Agent") -> str | None:
    """Let an agent drive; returns why it stopped early, or None."""
    from gsrain_engine.simulation import simulation as driving
    from gsrain_engine.simulation.agents.http import ClientError

    scenario = simulation.scenario
    title = f"{scenario.rain.intensity_mm_h:g} mm/h, {agent.name}"
    longest, made = round(scenario.duration_s / scenario.step_s), 0
    with progress_bar(title, longest) as advance:
        try:
            for _ in driving.drive(simulation, agent):
                made += 1
                advance()
            advance(longest - made)  # ended early
        except ClientError as error:
            return str(error)
        except ValueError as error:
            return f"agent {agent.name}: {error}"
        except KeyboardInterrupt:
            return "stopped"
        except Exception as error:  # an agent may be any code
            frame = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(frame.filename).name}, line {frame.lineno}"
            return f"agent {agent.name}: {type(error).__name__}: {error} ({place})"
    if simulation.end != "agent":
        return None
    last = simulation.rollout(agent.name).steps[-1]
    return str(last.notes.get("problem", f"{agent.name} had no plan at {last.time_s:g} s"))


def _rains(
    own: RainSettings, intensities: str | None, preset: str | None, options: StructOptions
) -> list[RainSettings]:
    """Return the rain settings of the runs, by default only the scenario's own."""
    from gsrain_engine.rain.calibration import load_calibration

    base = own
    if preset is not None:
        base = msgspec.structs.replace(load_preset(preset), intensity_mm_h=own.intensity_mm_h, seed=own.seed)
    chosen = [base.intensity_mm_h] if intensities is None else parse_intensities(intensities)
    rains = [options.settings(base, intensity_mm_h=each) for each in chosen]
    check_available(options.changes(), rains[0])
    load_calibration(rains[0].calibration)  # before anything is drawn
    return rains


# Output files

_WORD_BYTES = 90  # maximum length of a scenario's and of an agent's name within a file name


@dataclass(frozen=True, slots=True)
class DriveFiles:
    """Output folder and chosen files of a command."""

    folder: Path
    exports: "Mapping[str, DriveExport]"
    fps: float

    def check(self) -> None:
        """Raise ValueError for formats that write the same files, and for frame rates out of bounds."""
        suffixes = [".jsonl", ".mp4", *(suffix for each in self.exports.values() for suffix in each.suffixes)]
        doubled = next((suffix for suffix in suffixes if suffixes.count(suffix) > 1), None)
        if doubled is not None:
            raise ValueError(f"--export {','.join(self.exports)}: two files of a run would end in {doubled}")
        check_within("--fps", self.fps, 1, 60)

    def of(self, scenario: str, agent: str, intensity_mm_h: float, seed: int, suffix: str) -> Path:
        name = self.figure(scenario, agent).stem
        return self.folder / f"{name}_{intensity_mm_h:g}mm_seed{seed}{suffix}"

    def figure(self, scenario: str, agent: str) -> Path:
        """Return the figure of an agent in a scenario; the two names are shortened separately."""
        word = f"{shortened(scenario, _WORD_BYTES)}_{shortened(agent, _WORD_BYTES)}"
        return self.folder / f"{file_word(word, 2 * _WORD_BYTES + 1)}.png"

    def planned(
        self, scenario: str, agents: Sequence[str], rains_mm_h: Sequence[float], seed: int, *, films: bool
    ) -> list[Path]:
        """Return all files that runs of these agents in these rains will write."""
        suffixes = [".jsonl", *[".mp4"] * films]
        suffixes += [suffix for each in self.exports.values() if not each.is_folder for suffix in each.suffixes]
        runs = [
            self.of(scenario, agent, rain, seed, suffix)
            for agent, rain, suffix in product(agents, rains_mm_h, suffixes)
        ]
        figures = [self.figure(scenario, agent) for agent in agents]
        return [self.folder / name for name in ("report.html", "table.md", "table.csv")] + figures + runs


def write_drives(
    files: DriveFiles,
    runs: "Sequence[ScoredRun]",
    scene: "Scene",
    renderer: "Renderer | None",
    settings: Mapping[str, object],
    lod: Lod | None = None,
    pictures: "Mapping[str, PictureProvenance] | None" = None,
    *,
    films: bool,
) -> list[str]:
    """Write all outputs of runs in one scene, with videos if it `films`. Returns the files' names.

    The renderer is for videos and for the images in bags of ROS 2. `settings` are listed in the report in addition to
    those in the runs; provenance.json has what the `pictures` that agents saw held, and those of the videos.
    """
    from gsrain_engine.report.page import write_report
    from gsrain_engine.simulation.ground import recorded_route

    # Matplotlib loads slowly: import it only after the first drive.
    from gsrain_engine.simulation.metrics.figures import kinematics_figure, write_figure
    from gsrain_engine.simulation.metrics.report import drive_report_page
    from gsrain_engine.simulation.metrics.summary import compare_drives, metrics_table, results_table

    files.folder.mkdir(parents=True, exist_ok=True)
    shown = dict(pictures or {})
    written = [path for run in runs for path in _write_run(files, run, scene, renderer, lod, films, shown)]
    if shown:
        written.append(files.folder / "provenance.json")
        write_provenance(files.folder, shown, written[-1])
    compared = compare_drives(runs)
    write_text(files.folder / "table.md", results_table(compared).markdown)
    metrics_table([run.metrics for run in runs]).write_csv(files.folder / "table.csv")
    figures = {files.figure(each.scenario, each.agent): kinematics_figure(each) for each in compared}
    for path, figure in figures.items():
        write_figure(path, figure)
    write_report(files.folder / "report.html", drive_report_page(runs, {scene.name: recorded_route(scene)}, settings))
    return ["report.html", "table.md", "table.csv", *(path.name for path in (*figures, *written))]


def _write_run(
    files: DriveFiles, run: "ScoredRun", scene: "Scene", renderer: "Renderer | None", lod: Lod | None, films: bool,
    shown: "dict[str, PictureProvenance]",
) -> list[Path]:  # fmt: skip
    from gsrain_engine.simulation.playback import RolloutPlayback
    from gsrain_engine.simulation.rollout_io import write_rollout
    from gsrain_engine.simulation.video import RolloutVideo, render_rollout_video

    rollout, metrics = run.rollout, run.metrics
    assert rollout is not None

    def file(suffix: str) -> Path:
        return files.of(metrics.scenario, metrics.agent, metrics.intensity_mm_h, metrics.seed, suffix)

    write_rollout(file(".jsonl"), rollout)
    written = [file(".jsonl")]
    for export in files.exports.values():
        paths = [file(suffix) for suffix in export.suffixes]
        _export(export, paths[0], rollout, scene, renderer, lod)
        written += paths
    if renderer is not None and films:
        video = RolloutVideo(RolloutPlayback(rollout, scene), renderer, lod)
        shown[file(".mp4").name] = video.provenance
        with progress_bar("Filming", len(video.times(files.fps))) as advance:
            for _ in render_rollout_video(file(".mp4"), video, files.fps):
                advance()
        written.append(file(".mp4"))
    return written


def _export(
    export: "DriveExport",
    path: Path,
    rollout: "Rollout | None",
    scene: "Scene",
    renderer: "Renderer | None",
    lod: Lod | None,
) -> None:
    from gsrain_engine.simulation.drive_exports import FinishedDrive

    assert rollout is not None
    drive = FinishedDrive(export, rollout, scene, renderer, lod)
    if not drive.record_count:
        export.write(drive, path)
        return
    with progress_bar("Recording", drive.record_count) as advance:
        drive.on_record = advance
        export.write(drive, path)
