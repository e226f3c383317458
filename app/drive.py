"""`gsrain drive [SCENARIO.yaml]`: closed-loop simulation of scene, rain and agent."""

import re
import traceback
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from cyclopts import Parameter

from gsrain_engine.backends import Backend, open_renderer
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.render.video import can_write_videos
from gsrain_engine.scene.files import file_word
from gsrain_engine.scene.open import load_sorted_scene, scene_hash
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation import simulation as driving
from gsrain_engine.simulation.agents.base import Agent
from gsrain_engine.simulation.agents.http import ClientError
from gsrain_engine.simulation.agents.registry import AgentOptions, agent_file, agent_names, default_agent, open_agent
from gsrain_engine.simulation.metrics.summary import ScoredRun, compare_drives, results_table
from gsrain_engine.simulation.obstacles import drivable_of
from gsrain_engine.simulation.rollout import BACKGROUND
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.simulation.simulation import Simulation
from gsrain_engine.sweep.expansion import software

from .console import print, print_lines
from .drive_outputs import DriveFiles, write_drives
from .evaluate.run_facts import provenance_lines, run_provenance
from .options import RAIN_OPTIONS, JsonFile, check_writable, converted_options, lock_outputs, write_numbers
from .progress import progress_bar

DEFAULT_SCENARIO = "stationary-lead"
_LONGEST_S = 600.0

# Agents


@Parameter(name="*")  # fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class DriverOptions:
    """Options about agents."""

    agent: Annotated[
        list[str] | None,
        Parameter(
            help="Who drives: constant-velocity, oracle-idm, camera-idm, neuroncap-baseline, http, hugsim, or one of "
            "an installed package (entry points gsrain.agents); FILE.py or FILE.py:NAME is a class of your own. May be "
            "given several times. "
            "Default: camera-idm where a detector is found, else oracle-idm.",
            negative="",
        ),
    ] = None
    detector: Annotated[Path | None, Parameter(help="ONNX file of camera-idm's detector.")] = None
    description: Annotated[
        str | None, Parameter(help="How the detector is used: a shipped name such as yolox, or a YAML file.")
    ] = None
    url: Annotated[str | None, Parameter(help="Where the agent http listens, such as http://localhost:9000.")] = None
    hugsim_dir: Annotated[
        Path | None, Parameter(help="Folder with the pipes of HUGSIM's protocol: UniAD, VAD or LTF drives.")
    ] = None
    hugsim_client: Annotated[
        str | None,
        Parameter(help="Command that starts the client; without one, start it yourself on the folder.", negative=""),
    ] = None
    hugsim_wait: Annotated[
        float, Parameter(help="Seconds to wait for the client's first plan; at most 60 of them for each later one.")
    ] = 120.0
    hugsim_all: Annotated[
        bool, Parameter(help="Send the client depth and semantic classes too, which takes longer to draw.", negative="")
    ] = False
    channel_order: Annotated[Literal["rgb", "bgr"], Parameter(help="Of the pictures in HUGSIM's protocol.")] = "rgb"

    def names(self) -> list[str]:
        """Return the names of the chosen agents. Raises ValueError for unknown or contradictory ones."""
        asked = list(dict.fromkeys(self.agent or []))
        if self.hugsim_dir is not None and asked not in ([], [HUGSIM]):
            raise ValueError("--hugsim-dir is for the agent hugsim alone; leave out --agent")
        if not 0 < self.hugsim_wait <= 86_400:
            raise ValueError(f"--hugsim-wait {self.hugsim_wait:g}: must be above 0 and at most 86400 s")
        known = (*agent_names(), HUGSIM)
        unknown = next((name for name in asked if name not in known and agent_file(name) is None), None)
        if unknown is not None:
            raise ValueError(f"--agent {unknown}: there is only {', '.join(known)}, or a file FILE.py")
        return [HUGSIM] if self.hugsim_dir is not None else asked

    def fitted(self, scenario: Scenario, scene: Scene) -> tuple[Scenario, Scene]:
        """Return scenario and scene with the rig and vehicle that HUGSIM's clients expect, if one is used."""
        if self.hugsim_dir is None:
            return scenario, scene
        from gsrain_engine.simulation.interop.hugsim_protocol import with_hugsim_rig

        return with_hugsim_rig(scenario, scene)

    @contextmanager
    def opened(self) -> Generator[list[Agent]]:
        """Open all agents for the duration of the block; prints why a default agent was substituted."""
        with ExitStack() as stack:
            agents = [self._open(name) for name in self.names()] or [self._defaults()]
            for agent in agents:
                stack.callback(agent.close)
            yield agents

    def _open(self, name: str) -> Agent:
        if name != HUGSIM:
            return open_agent(name, self._chosen_options)
        if self.hugsim_dir is None:
            raise ValueError("--agent hugsim takes the folder of its pipes: --hugsim-dir DIR")
        from gsrain_engine.simulation.interop.hugsim_agent import LATER_WAIT_S, HugsimAgent

        first_s, later_s = self.hugsim_wait, min(self.hugsim_wait, LATER_WAIT_S)
        return HugsimAgent(
            self.hugsim_dir, self.hugsim_client, self.channel_order, semantic=self.hugsim_all, depth=self.hugsim_all,
            first_wait_s=first_s, later_wait_s=later_s,
        )  # fmt: skip

    def _defaults(self) -> Agent:
        name, reason = default_agent(self._chosen_options)
        if reason is not None:
            print(reason)
        return open_agent(name, self._chosen_options)

    @property
    def _chosen_options(self) -> AgentOptions:
        return AgentOptions(self.detector, self.description, self.url)


def drive(
    scenario: Annotated[
        str | None,
        Parameter(
            name="SCENARIO.yaml",
            help="A shipped scenario by name or a file: ours, HUGSIM's YAML or OpenSCENARIO; default: stationary-lead.",
        ),
    ] = None,
    /,
    *,
    driver: DriverOptions | None = None,
    rain: Annotated[
        str | None, Parameter(help="Intensities in mm/h, 0..100, with commas between; default: the scenario's.")
    ] = None,
    seed: Annotated[
        int | None, Parameter(help="Same seed, same drops and the same drive; default: the scenario's.")
    ] = None,
    preset: Annotated[str | None, Parameter(help="Rain preset for all but intensity and seed.")] = None,
    exposure: Annotated[float | None, Parameter(help="Shutter time in seconds; default: the camera's own.")] = None,
    scene: Annotated[str | None, Parameter(help="Scene file or folder, or street; default: the scenario's.")] = None,
    wet: Annotated[
        bool, Parameter(help="First give the scene wet colours, as the window's preview job does.", negative="")
    ] = False,
    rig: Annotated[str | None, Parameter(help="Rig of the scene; default: the scenario's, else the first.")] = None,
    width: Annotated[int | None, Parameter(help="Width of the pictures in pixels; default: the scenario's.")] = None,
    duration: Annotated[float | None, Parameter(help="Longest duration in seconds; default: the scenario's.")] = None,
    output: Annotated[
        Path | None,
        Parameter(name=["--output", "-o"], help="Folder for all that is written; default: drive-NAME, right here."),
    ] = None,
    video: Annotated[bool | None, Parameter(help="Film each run; default: where there is only one.")] = None,
    fps: Annotated[float, Parameter(help="Frames a second of the films.")] = 10.0,
    export: Annotated[
        str, Parameter(help="More forms of each run, with commas: parquet, mcap (Foxglove), xosc (OpenSCENARIO).")
    ] = "",
    backend: Annotated[Backend, Parameter(help="auto takes OpenGL on a GPU, else the processor.")] = "auto",
    json: JsonFile = None,
) -> None:
    """Test a driver in the rain: an agent sees the scene and plans, and the vehicle follows its plan.

    A folder gets each run as JSON lines (which the window opens), a table like the paper's, figures over time, a report
    and a video. Without SCENARIO.yaml a car is stationary in the lane of the built-in street.
    """
    asked = driver or DriverOptions()
    test = _as_asked(load_scenario(scenario or DEFAULT_SCENARIO), scene, rig, width, duration)
    rains = _rains(test.rain, rain, preset, exposure)
    folder = output or Path(f"drive-{file_word(test.name)}")
    files = DriveFiles(folder, frozenset(_words(export)), fps)
    files.check()
    check_writable(json, folders=[folder])
    lock_outputs(folder)
    with ExitStack() as stack:
        agents = stack.enter_context(asked.opened())  # before the scene, which takes longer to read
        hashed = scene_hash(test.scene)
        test, opened = asked.fitted(test, _opened(test.scene, wet))
        can_film = can_write_videos() and bool(opened.rigs)
        films = video if video is not None else len(agents) * len(rains) == 1 and can_film
        if films and not opened.rigs:
            raise ValueError(f"--video: scene {opened.name!r} has no rig whose front camera could film")
        names, rains_mm_h = [each.name for each in agents], [each.intensity_mm_h for each in rains]
        doubled = next((name for name in names if names.count(name) > 1), None)
        if doubled is not None:
            raise ValueError(f"--agent: two agents are called {doubled!r}, and so would be their files")
        own_seed = test.rain.seed if seed is None else seed
        check_writable(json, *files.planned(test.name, names, rains_mm_h, own_seed, films=films))
        renderer = None
        if films or any(agent.needs.cameras for agent in agents):
            renderer = stack.enter_context(open_renderer(backend))
        runs: list[ScoredRun] = []
        problem: str | None = None
        for agent, each in product(agents, rains):
            simulation = Simulation(msgspec.structs.replace(test, rain=each), opened, agent.needs, renderer, seed)
            problem = _drive(simulation, agent)
            runs.append(_run(simulation, agent, hashed))
            if problem is not None:  # results so far are written anyway
                break
        facts = run_provenance({})  # the runs name their scene
        written = write_drives(files, runs, opened, renderer if films else None, provenance_lines(facts))
    print_lines(results_table(compare_drives(runs)).text)
    if len(rains) > 1:
        for name in [agent.name for agent in agents if not agent.needs.cameras]:
            print(f"{name} looks at no picture: rain changes nothing for it.")
    if any(len(run.rollout.steps) == 1 and run.rollout.steps[0].collision == BACKGROUND for run in runs if run.rollout):
        print(
            f"It begins inside of what stands in scene {opened.name!r}: is a unit as long as its folder says, and the "
            "start free? `ahead_m` of the scenario moves it along."
        )
    print(f"{folder}:")
    for name in written:
        print(f"  {name}")
    rows = [msgspec.to_builtins(run.metrics) for run in runs]
    write_numbers(json, {**rows[0], "rows": rows} if len(rows) == 1 else {"rows": rows})
    if problem is not None:
        raise ValueError(problem)


def _drive(simulation: Simulation, agent: Agent) -> str | None:
    """Let an agent drive; returns why it stopped early, or None."""
    scenario = simulation.scenario
    title = f"{scenario.rain.intensity_mm_h:g} mm/h, {agent.name}"
    longest, made = round(scenario.duration_s / scenario.step_s), 0
    with progress_bar(title, longest, draws=True) as advance:
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
            return f"agent {agent.name}: {type(error).__name__}: {error} ({_place(error)})"
    if simulation.end != "agent":
        return None
    last = simulation.rollout(agent.name).steps[-1]
    return str(last.notes.get("problem", f"{agent.name} had no plan at {last.time_s:g} s"))


def _place(error: Exception) -> str:
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(frame.filename).name}, line {frame.lineno}"


def _run(simulation: Simulation, agent: Agent, hashed: str) -> ScoredRun:
    drivable = drivable_of(simulation.scene, simulation.ground, simulation.occupied)
    rollout = msgspec.structs.replace(simulation.rollout(agent.name), scene_hash=hashed, software=software())
    return ScoredRun.of(rollout, simulation.occupied, drivable)


def _as_asked(
    scenario: Scenario, scene: str | None, rig: str | None, width: int | None, duration: float | None
) -> Scenario:
    if duration is not None and not 0 < duration <= _LONGEST_S:
        raise ValueError(f"--duration {duration:g}: must be above 0 and at most {_LONGEST_S:g} s")
    if width is not None and not (64 <= width <= 4096 and width % 2 == 0):
        raise ValueError(f"--width {width}: must be even and within 64..4096 px")
    asked = {"scene": scene, "rig": rig, "picture_width_px": width, "duration_s": duration}
    values = msgspec.to_builtins(scenario) | {name: value for name, value in asked.items() if value is not None}
    return msgspec.convert(values, Scenario)


def _rains(
    own: RainSettings, intensities: str | None, preset: str | None, exposure: float | None
) -> list[RainSettings]:
    """Return the rain settings of the runs, by default only the scenario's own."""
    base = own
    if preset is not None:
        base = msgspec.structs.replace(load_preset(preset), intensity_mm_h=own.intensity_mm_h, seed=own.seed)
    values = msgspec.to_builtins(base) | ({} if exposure is None else {"exposure_s": exposure})
    if intensities is None:
        return [converted_options(values, RainSettings, RAIN_OPTIONS)]
    words = _words(intensities)
    if not words or not all(re.fullmatch(r"\d*\.?\d+", word) and float(word) <= 100 for word in words):
        raise ValueError(f"--rain {intensities}: expected mm/h within 0..100 with commas between, such as 0,1.2,8.5,12")
    chosen = sorted({float(word) for word in words})
    return [converted_options(values | {"intensity_mm_h": each}, RainSettings, RAIN_OPTIONS) for each in chosen]


def _opened(name: str, wet: bool) -> Scene:
    scene = load_sorted_scene(name)
    if not wet:
        return scene
    # Loading kernels takes a second, so import them only here.
    from gsrain_engine.recolor.wet_scene import wet_scene

    from .progress import followed

    return followed(wet_scene(scene))


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


HUGSIM = "hugsim"
"""Not in the registry: it takes a folder of pipes, and changes scene and scenario."""
