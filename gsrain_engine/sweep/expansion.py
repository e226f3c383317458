"""Expansion of a sweep into jobs, shards of a sweep, and software versions."""

import hashlib
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from msgspec import Struct, structs

from ..choices import LAMP_WORDS, Backend, LabelFormat
from ..evaluation.attribution.factors import RainFactors, is_attributed
from ..evaluation.attribution.shapley import Coalition
from ..evaluation.detection.detector import find_detector
from ..plugins import AGENTS, DECODERS, SCENE_FORMATS, find_extensions
from ..rain.calibration import calibration_names
from ..rain.settings import RainSettings
from ..render.export_settings import ExportSettings
from ..safe_io.file_names import name_problem
from ..scene.formats.hugsim import is_vehicle_folder
from ..scene.lamp_choice import lamp_choice
from ..scene.open import file_hash, scene_hash
from ..scene.sensor import DEFAULT_SENSOR, load_sensor, sensor_names
from ..simulation.agents.options import HUGSIM
from ..simulation.agents.registry import agent_file, agent_names
from ..simulation.scenario import Scenario
from ..simulation.scenario_io import load_scenario
from .settings import AgentChoice, DriveSweep, RenderSweep, Sweep, Variant, apply_jitter, seeds_of

# Jobs: everything that a result depends on, and nothing else


class _Content(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fields shared by jobs of all kinds."""

    program: str
    scene: str
    """Scene name as given; copied to roll-outs."""
    scene_hash: str
    files: dict[str, str] = {}
    """Hashes of all other input files, by file name."""
    packages: dict[str, str] = {}
    """Versions of the plugin packages that provide the agent, scene formats or decoders, by package name."""
    seed: int
    backend: Backend

    @property
    def id(self) -> str:
        """Hash of the content (20 hex digits), equal for equal jobs on every machine."""
        return hashlib.sha256(msgspec.json.encode(self, order="sorted")).hexdigest()[:20]

    def shared(self, kind: str) -> dict[str, Any]:
        """Return values for the parameter columns that jobs of all kinds have."""
        names = ("scene", "scene_hash", "seed", "backend", "program")
        return {"id": self.id, "kind": kind, **{name: getattr(self, name) for name in names}}


class DriveJob(_Content, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="drive"):
    """A closed-loop drive."""

    scenario: Scenario
    """The scenario with this job's rain, scene and jittered start."""
    agent: AgentChoice
    variant: Variant = Variant()

    @property
    def title(self) -> str:
        """Title for logs and progress messages."""
        rain = f"{self.scenario.rain.intensity_mm_h:g} mm/h"
        return ", ".join(
            filter(None, [self.scenario.name, rain, self.variant.title, f"seed {self.seed}", self.agent.title])
        )

    @property
    def parameters(self) -> dict[str, Any]:
        """Values for the parameter columns of the row."""
        scenario, agent = self.scenario, self.agent
        own = {"scenario": scenario.name, "intensity_mm_h": scenario.rain.intensity_mm_h}
        return (
            self.shared("drive") | own | structs.asdict(self.variant) | {"agent": agent.title, "agent_name": agent.name}
        )


class RenderJob(_Content, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="render"):
    """A rendered video or image sequence with labels."""

    rain: RainSettings
    recording: ExportSettings
    labels: LabelFormat | None = None

    @property
    def title(self) -> str:
        """Title for logs and progress messages."""
        sensor = [] if self.rain.sensor is None else [f"sensor {Path(self.rain.sensor).stem}"]
        return ", ".join([self.scene, f"{self.rain.intensity_mm_h:g} mm/h", *sensor, f"seed {self.seed}"])

    @property
    def parameters(self) -> dict[str, Any]:
        """Values for the parameter columns of the row."""
        own = {"intensity_mm_h": self.rain.intensity_mm_h, "sensor": self.rain.sensor, "labels": self.labels}
        return self.shared("render") | own

    @property
    def is_labeled(self) -> bool:
        """True if the clip has a label pass or object labels."""
        return self.labels is not None or "labels" in self.recording.passes

    @property
    def labels_id(self) -> str:
        """Hash of everything that the labels depend on, which is not the rain: equal for all intensities and seeds."""
        return structs.replace(self, rain=RainSettings(), seed=0, files={}).id


Job = DriveJob | RenderJob


def jobs_of(sweep: Sweep) -> list[Job]:
    """Return all combinations of a sweep without duplicates, sorted by scene. Reads and hashes all input files.

    Raises ValueError for a missing scenario, agent or scene, and OSError for an unreadable file.
    """
    jobs: list[Job] = list(drives_of(sweep)) if isinstance(sweep, DriveSweep) else _renders(sweep)
    if isinstance(sweep, DriveSweep):
        jobs += [job for each in attributed_drives(sweep) for job in each.jobs.values()]
    jobs.sort(key=lambda job: job.scene)
    return list({job.id: job for job in jobs}.values())


def drives_of(sweep: DriveSweep) -> list[DriveJob]:
    """Return all combinations of a sweep of drives, without those in parts of their rain."""
    agents = [_complete(AgentChoice(name=each) if isinstance(each, str) else each) for each in sweep.agents]
    _check(agents)
    hashes, scenarios = _Hashes(), [load_scenario(name) for name in sweep.scenarios]
    for name in (names := [scenario.name for scenario in scenarios]):
        if names.count(name) > 1:
            raise ValueError(f"two scenarios are called {name!r}: tables could not tell them apart")
    return [
        _drive(sweep, hashes, structs.replace(scenario, scene=scene), agent, variant, intensity, seed)
        for scenario in scenarios
        for scene in sweep.scenes or (scenario.scene,)
        for agent in agents
        for variant in sweep.variants
        for intensity in sweep.intensities_mm_h
        for seed in seeds_of(sweep)
    ]


def _drive(
    sweep: DriveSweep,
    hashes: "_Hashes",
    scenario: Scenario,
    agent: AgentChoice,
    variant: Variant,
    intensity: float,
    seed: int,
) -> DriveJob:
    scenario = variant.of(scenario)
    rain = structs.replace(scenario.rain, intensity_mm_h=intensity, seed=seed)
    if is_attributed(sweep.attribute):
        factors = RainFactors.of(rain, sweep.attribute, scenario.scene, friction=scenario.friction)
        rain, scenario = factors.rain, structs.replace(scenario, friction=factors.friction)
    scenario = structs.replace(apply_jitter(scenario, sweep.jitter, seed), rain=rain)
    models = [user.model for user in scenario.road_users]
    own = agent_file(agent.name)
    return DriveJob(
        program=program_version(),
        scene=scenario.scene,
        scene_hash=hashes.scene(scenario.scene),
        packages=_packages([scenario.scene, *models], agent),
        files=hashes.files(
            [rain.calibration, rain.sensor, rain.lamps, *models, agent.detector, agent.description, own and str(own)]
        ),
        seed=seed,
        backend=sweep.backend,
        scenario=scenario,
        agent=agent,
        variant=variant,
    )


class AttributedDrive(NamedTuple):
    """A drive, and the same with parts of its rain."""

    drive: DriveJob
    factors: RainFactors
    jobs: dict[Coalition, DriveJob]
    """Jobs of the evaluated coalitions; that of all factors is the drive itself."""


def attributed_drives(sweep: DriveSweep) -> list[AttributedDrive]:
    """Return the drives in rain of a sweep that attributes, each with the jobs of its coalitions; else none.

    Raises ValueError for a rain without any factor.
    """
    if not is_attributed(sweep.attribute):
        return []
    hashes = cache(scene_hash)
    found: list[AttributedDrive] = []
    for drive in drives_of(sweep):
        rain = drive.scenario.rain
        if rain.intensity_mm_h > 0:
            factors = RainFactors.of(rain, sweep.attribute, drive.scene, friction=drive.scenario.friction)
            if not factors.names:
                raise ValueError(f"attribute: the rain of {drive.title} has no factors")
            jobs = {each: _coalition(drive, factors, each, hashes) for each in factors.evaluated}
            found.append(AttributedDrive(drive, factors, jobs))
    if not found:
        raise ValueError("attribute: expected an intensity above 0 mm/h")
    return found


def _coalition(drive: DriveJob, factors: RainFactors, present: Coalition, hashes: Callable[[str], str]) -> DriveJob:
    weather = factors.weather(present)
    scene = factors.twin if weather.in_twin and factors.twin is not None else drive.scene
    scenario = structs.replace(drive.scenario, rain=weather.rain, scene=scene, friction=weather.friction)
    return structs.replace(drive, scenario=scenario, scene=scene, scene_hash=hashes(scene))


def _complete(agent: AgentChoice) -> AgentChoice:
    """Fill in the default detector, because the result depends on it."""
    if agent.name != "camera-idm" or agent.detector is not None:
        return agent
    try:
        return structs.replace(agent, detector=str(find_detector()))
    except FileNotFoundError as error:
        raise ValueError(f"agent {agent.title}: {error}") from None


def _packages(scenes: list[str], agent: AgentChoice | None = None) -> dict[str, str]:
    """Return versions of the plugins for these scene formats, the agent and the decoders.

    All decoders count, because a detector selects its decoder only when it is opened.
    """
    names = [name.lower() for name in scenes]
    used = [
        each for each in find_extensions(SCENE_FORMATS) if any(name.endswith(f".{each.name.lower()}") for name in names)
    ]
    if agent is not None:
        used += [each for each in find_extensions(AGENTS) if each.name == agent.name]
        used += find_extensions(DECODERS) if agent.detector is not None else ()
    return {each.package: each.version for each in used if not each.is_own}


def _renders(sweep: RenderSweep) -> list[Job]:
    hashes = _Hashes()
    recording = sweep.recording
    if sweep.labels is not None and "depth" not in recording.passes:
        recording = structs.replace(recording, passes=(*recording.passes, "depth"))
    try:
        recording.check()
    except ValueError as error:
        raise ValueError(f"recording.output {error}") from None
    if recording.path.is_absolute() or ".." in recording.path.parts or not recording.path.parts:
        expected = "expected a name in the clip's own folder, as clip.mp4"
        raise ValueError(f"recording.output {recording.output!r}: {expected}")
    if (problem := name_problem(recording.path)) is not None:
        raise ValueError(f"recording.output: {problem}")
    sensors = sweep.sensor or (sweep.rain.sensor,)
    for sensor in sensors:
        load_sensor(sensor or DEFAULT_SENSOR)  # raises for a missing or wrong one before the first clip
    lamp_choice(sweep.rain.lamps)
    return [
        RenderJob(
            program=program_version(),
            scene=scene,
            scene_hash=hashes.scene(scene),
            packages=_packages([scene]),
            files=hashes.files([sweep.rain.calibration, sensor, sweep.rain.lamps]),
            seed=seed,
            backend=sweep.backend,
            rain=structs.replace(sweep.rain, intensity_mm_h=intensity, seed=seed, sensor=sensor),
            recording=recording,
            labels=sweep.labels,
        )
        for scene in sweep.scenes
        for sensor in sensors
        for intensity in sweep.intensities_mm_h
        # Without rain and noise all seeds are identical.
        for seed in seeds_of(sweep)[: None if intensity > 0 or sensor is not None else 1]
    ]


class _Hashes:
    """Scene and file hashes; each file is read once."""

    def __init__(self) -> None:
        self.scene = cache(scene_hash)
        self._file = cache(file_hash)

    def files(self, names: list[str | None]) -> dict[str, str]:
        """Hash existing files; shipped ones (calibrations, models and others) are covered by the program version."""
        shipped = (*calibration_names(), *sensor_names(), *LAMP_WORDS)
        paths = {name: Path(name) for name in names if name and name not in shipped}
        files = {name: self._file(path) for name, path in paths.items() if path.is_file()}
        vehicles = {name: self.scene(name) for name, path in paths.items() if is_vehicle_folder(path)}
        return dict(sorted((files | vehicles).items()))


def _check(agents: list[AgentChoice]) -> None:
    titles = [agent.title for agent in agents]
    for agent in agents:
        own = agent_file(agent.name)
        if own is not None and not own.is_file():
            raise ValueError(f"agent {agent.name}: no such file")
        if own is None and agent.name not in (*agent_names(), HUGSIM):
            raise ValueError(f"agent {agent.name}: there is none of that name, only {', '.join(agent_names())}")
        if agent.detector is not None and not Path(agent.detector).is_file():
            raise ValueError(f"agent {agent.title}: there is no detector {agent.detector}")
        if titles.count(agent.title) > 1:
            raise ValueError(f"two agents are called {agent.title!r}: give each a `label`")


# Shards: for independent machines such as the tasks of a SLURM array


class Shard(NamedTuple):
    """The i-th of n shards, counted from 1."""

    place: int
    shares: int

    @staticmethod
    def parse(text: str) -> "Shard":
        """Parse "i/n"; raises ValueError if malformed or if i is not within 1..n."""
        match = re.fullmatch(r"(\d+)/(\d+)", text.strip())
        if match is None:
            example = "1/10 or $SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT"
            raise ValueError(f"shard {text}: expected i/n, such as {example}")
        place, shares = int(match[1]), int(match[2])
        if not 1 <= place <= shares:
            raise ValueError(f"shard {text}: shares are counted from 1 to n, as by sbatch --array=1-{max(shares, 1)}")
        return Shard(place, shares)

    def of(self, jobs: Sequence[Job]) -> list[Job]:
        """Return the jobs of this shard in their order: every n-th by id, so that shards are balanced."""
        own = set(sorted(job.id for job in jobs)[self.place - 1 :: self.shares])
        return [job for job in jobs if job.id in own]

    def __str__(self) -> str:
        return f"{self.place}/{self.shares}"


def program_version() -> str:
    return metadata.version("gsrain")


def software() -> dict[str, str]:
    """Return versions of installed packages that affect rounding, by package name."""
    found = {"gsrain": program_version()}
    for name in ("numpy", "onnxruntime", "scipy", "shapely"):
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found
