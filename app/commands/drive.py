"""`gsrain drive [SCENARIO.yaml]`: a closed loop of scene, rain and driver."""

import re
import traceback
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from typing import Annotated

import msgspec
from cyclopts import Parameter

from gsrain_engine.backends import Backend, open_renderer
from gsrain_engine.drive.agents.agent import Agent
from gsrain_engine.drive.agents.client_error import ClientError
from gsrain_engine.drive.metrics.comparison import Run, compare
from gsrain_engine.drive.metrics.table import results_table
from gsrain_engine.drive.road.drivable import drivable_of
from gsrain_engine.drive.rollouts.rollout import BACKGROUND
from gsrain_engine.drive.scenario.scenario import Scenario
from gsrain_engine.drive.scenario.scenario_files import load_scenario
from gsrain_engine.drive.simulation import drive as driving
from gsrain_engine.drive.simulation.simulation import Simulation
from gsrain_engine.drive.sweeps.program import software
from gsrain_engine.rain.presets import load_preset
from gsrain_engine.rain.rain import Rain
from gsrain_engine.render.video import can_write_videos
from gsrain_engine.scene.content_hash import scene_hash
from gsrain_engine.scene.file_names import file_word
from gsrain_engine.scene.open_scene import open_to_draw
from gsrain_engine.scene.scene import Scene

from ..console import print, print_lines
from .arguments import JsonFile, write_numbers
from .converted_options import RAIN_OPTIONS, converted_options
from .driving.drive_files import DriveFiles, write_drives
from .driving.driver_options import DriverOptions
from .evaluate.run_facts import run_facts, told_facts
from .outputs import check_writable, hold
from .progress import progress_bar

DEFAULT_SCENARIO = "stationary-lead"
_LONGEST_S = 600.0


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
    """Test a driver in the rain: it sees the scene, says where it wants to be, and is driven there.

    A folder gets each run as JSON lines (which the window opens), a table like the paper's, figures over time, a report
    and a film. Without SCENARIO.yaml a car stands in the lane of the built-in street.
    """
    asked = driver or DriverOptions()
    test = _as_asked(load_scenario(scenario or DEFAULT_SCENARIO), scene, rig, width, duration)
    rains = _rains(test.rain, rain, preset, exposure)
    folder = output or Path(f"drive-{file_word(test.name)}")
    files = DriveFiles(folder, frozenset(_words(export)), fps)
    files.check()
    check_writable(json, folders=[folder])
    hold(folder)
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
        runs: list[Run] = []
        problem: str | None = None
        for agent, each in product(agents, rains):
            simulation = Simulation(msgspec.structs.replace(test, rain=each), opened, agent.needs, renderer, seed)
            problem = _drive(simulation, agent)
            runs.append(_run(simulation, agent, hashed))
            if problem is not None:  # what has been driven is written all the same
                break
        facts = run_facts({})  # the runs name their scene
        written = write_drives(files, runs, opened, renderer if films else None, told_facts(facts))
    print_lines(results_table(compare(runs)).text)
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
    """Let an agent drive; returns why it could not go on, if that is so."""
    scenario = simulation.scenario
    title = f"{scenario.rain.intensity_mm_h:g} mm/h, {agent.name}"
    longest, made = round(scenario.duration_s / scenario.step_s), 0
    with progress_bar(title, longest, draws=True) as advance:
        try:
            for _ in driving.drive(simulation, agent):
                made += 1
                advance()
            advance(longest - made)  # it ended before its time
        except ClientError as error:
            return str(error)
        except ValueError as error:
            return f"agent {agent.name}: {error}"
        except KeyboardInterrupt:
            return "stopped"
        except Exception as error:  # an agent may be anybody's code
            return f"agent {agent.name}: {type(error).__name__}: {error} ({_place(error)})"
    if simulation.end != "agent":
        return None
    last = simulation.rollout(agent.name).steps[-1]
    return str(last.notes.get("problem", f"{agent.name} had no plan at {last.time_s:g} s"))


def _place(error: Exception) -> str:
    """Return the file and the line where something went wrong."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(frame.filename).name}, line {frame.lineno}"


def _run(simulation: Simulation, agent: Agent, hashed: str) -> Run:
    """Measure what was driven."""
    drivable = drivable_of(simulation.scene, simulation.ground, simulation.occupied)
    rollout = msgspec.structs.replace(simulation.rollout(agent.name), scene_hash=hashed, software=software())
    return Run.of(rollout, simulation.occupied, drivable)


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


def _rains(own: Rain, intensities: str | None, preset: str | None, exposure: float | None) -> list[Rain]:
    """Return the rains of the runs; the scenario's own one where nothing else is asked for."""
    base = own
    if preset is not None:
        base = msgspec.structs.replace(load_preset(preset), intensity_mm_h=own.intensity_mm_h, seed=own.seed)
    values = msgspec.to_builtins(base) | ({} if exposure is None else {"exposure_s": exposure})
    if intensities is None:
        return [converted_options(values, Rain, RAIN_OPTIONS)]
    words = _words(intensities)
    if not words or not all(re.fullmatch(r"\d*\.?\d+", word) and float(word) <= 100 for word in words):
        raise ValueError(f"--rain {intensities}: expected mm/h within 0..100 with commas between, such as 0,1.2,8.5,12")
    chosen = sorted({float(word) for word in words})
    return [converted_options(values | {"intensity_mm_h": each}, Rain, RAIN_OPTIONS) for each in chosen]


def _opened(name: str, wet: bool) -> Scene:
    scene = open_to_draw(name)
    if not wet:
        return scene
    # Kernels take a second to load: only where they are needed.
    from gsrain_engine.reconstruct.wet_scene import wet_scene

    from .progress import followed

    return followed(wet_scene(scene))


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]
