"""Worker side of a sweep: runs one job and always returns a `JobResult`, also on failure."""

import errno
import hashlib
import os
import platform
import shutil
import tempfile
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Collection, Mapping
from contextlib import ExitStack
from pathlib import Path

import msgspec
from msgspec import Struct, structs

from ..backends import open_renderer
from ..choices import Backend
from ..rain.simulation import RainSimulation
from ..recolor.cached_colors import cached_wet_scene
from ..render.export import export_frames, export_sequences, first_pictures, frame_numbers
from ..render.export_settings import ExportSettings
from ..render.label_export import write_object_labels
from ..render.renderer import Renderer
from ..render.sequence import FrameSequence
from ..report.numbers import write_json
from ..safe_io.files import PathInUseError, whole_folder
from ..scene.camera import Camera
from ..scene.camera_path import CameraPath
from ..scene.open import file_hash, load_sorted_scene, scene_hash
from ..scene.progress import run_to_end
from ..scene.rig import rig_camera_path
from ..scene.scene import Scene
from ..simulation.agents.base import Agent
from ..simulation.agents.registry import AgentOptions, open_agent
from ..simulation.interop.hugsim_agent import LATER_WAIT_S, ClientStartError, HugsimAgent
from ..simulation.interop.hugsim_protocol import with_hugsim_rig
from ..simulation.metrics.summary import measure_drive
from ..simulation.obstacles import drivable_of
from ..simulation.rollout import Rollout
from ..simulation.simulation import Simulation, run_drive
from ..trusted_code import UntrustedCodeError, check_trusted, command_code, trust
from .expansion import DriveJob, Job, RenderJob, program_version, software
from .settings import AgentChoice

_FULL = {errno.ENOSPC, errno.EDQUOT}
LABELS = "labels"
"""Folder in a sweep's folder with the labels that clips share, a folder for each scene and sequence."""

_LOOK_EVERY_S = 0.1
_ONE_AT_A_TIME = threading.Lock()
"""Compiled kernels use all threads of a process, so concurrent jobs in one process bring no gain."""

Value = str | float | int | bool | None


class JobResult(Struct, frozen=True, kw_only=True):
    """The result or the error of a job. All but the last two fields depend on the job alone."""

    id: str
    values: dict[str, Value] = {}  # measured columns of the row
    rollout: Rollout | None = None
    error: str | None = None
    stops: bool = False  # true if no other job can succeed either, such as on a full disk
    seconds: float = 0.0  # run time, for the log
    worker: str = ""  # host and process id, for the log


def run_job(job: Job, clips: Path, trusted: Collection[str] = (), clients: Path | None = None) -> JobResult:
    """Run a job; exceptions become the error of the result. `trusted` holds digests of trusted agent code.

    The output of a HUGSIM client goes to a file of the folder `clients`, named by the job's id, if the folder is given.
    """
    started = time.perf_counter()
    with _ONE_AT_A_TIME:
        try:
            trust(trusted)
            here = program_version()
            if job.program != here:
                raise MismatchError(f"a worker runs gsrain {here}, the sweep was made by gsrain {job.program}")
            cache = worker_cache()
            cache.check_files(job.files)
            if isinstance(job, DriveJob):
                outcome = run_drive_job(job, cache, None if clients is None else clients / f"{job.id}.txt")
            else:
                outcome = run_render_job(job, cache, clips)
        except Exception as error:
            stops = isinstance(error, MismatchError | UntrustedCodeError | ClientStartError) or _is_full(error)
            words = " ".join(str(error).split()) or type(error).__name__
            if clients is not None:  # a row depends on the job alone, and equal errors are counted together
                words = words.replace(str(clients / f"{job.id}.txt"), f"the job's file in {clients.name}")
            sentence = words if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {words}"
            outcome = JobResult(id=job.id, error=sentence, stops=stops)
    values = {**outcome.values, "software": ", ".join(f"{name} {each}" for name, each in software().items())}
    seconds, worker = time.perf_counter() - started, f"{platform.node()} {os.getpid()}"
    return structs.replace(outcome, values=values, seconds=seconds, worker=worker)


def _is_full(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL:
            return True
        error = error.__cause__
    return False


class MismatchError(ValueError):
    """The worker's program or files differ from the sweep's; the job itself may be fine."""


_SCENES = 2  # number of scenes kept open; jobs are sorted by scene


class WorkerCache:
    """Scenes and renderers, opened on first use."""

    def __init__(self) -> None:
        self._scenes: OrderedDict[tuple[str, str, bool], Scene] = OrderedDict()
        self._renderers: dict[Backend, Renderer] = {}
        self._stack = ExitStack()

    def scene(self, name: str, content: str, *, wet: bool = False) -> Scene:
        """Return a scene after checking its hash, with wet colors if asked for: a minute at first, then from the cache.

        Raises MismatchError if the scene has changed.
        """
        key = name, content, wet
        if key not in self._scenes:
            found = scene_hash(name)
            if found != content:
                raise MismatchError(f"scene {name} is not what it was when the sweep began ({found}, not {content})")
            while len(self._scenes) >= _SCENES:
                self._scenes.popitem(last=False)
            opened = load_sorted_scene(name)
            self._scenes[key] = run_to_end(cached_wet_scene(opened)) if wet else opened
        self._scenes.move_to_end(key)
        return self._scenes[key]

    def check_files(self, hashes: Mapping[str, str]) -> None:
        """Raise MismatchError for a missing or changed file."""
        for name, content in hashes.items():
            path = Path(name)
            found = file_hash(path) if path.is_file() else "not there"
            if found != content:
                raise MismatchError(f"{name} is not what it was when the sweep began ({found}, not {content})")

    def renderer(self, backend: Backend) -> Renderer:
        if backend not in self._renderers:
            self._renderers[backend] = self._stack.enter_context(open_renderer(backend))
        return self._renderers[backend]

    def close(self) -> None:
        """Release scenes and renderers; the cache stays usable."""
        self._scenes.clear()
        self._renderers.clear()
        self._stack.close()


_THREAD = threading.local()


def worker_cache() -> WorkerCache:
    """Return this thread's cache; a renderer belongs to the thread that opened it."""
    if not hasattr(_THREAD, "cache"):
        _THREAD.cache = WorkerCache()
    return _THREAD.cache


def run_drive_job(job: DriveJob, cache: WorkerCache, client_output: Path | None = None) -> JobResult:
    """Run a closed-loop drive and measure it. Raises errors of the scenario, the scene or the agent."""
    with ExitStack() as stack:
        agent, scenario = _opened_agent(job.agent, stack, client_output), job.scenario
        sees = bool(agent.needs.cameras)
        scene = cache.scene(job.scene, job.scene_hash, wet=bool(job.variant.wet) and sees)
        if job.agent.hugsim is not None:
            scenario, scene = with_hugsim_rig(scenario, scene)
        renderer = cache.renderer(job.backend) if sees else None
        simulation = Simulation(scenario, scene, agent.needs, renderer, job.seed)
        rollout = run_drive(simulation, agent)
        versions = {**rollout.software, **software()}
        rollout = structs.replace(rollout, scene_hash=job.scene_hash, software=versions)
        drivable = drivable_of(scene, simulation.ground, simulation.occupied)
        metrics = measure_drive(rollout, simulation.occupied, drivable)
    msgspec.json.encode(rollout)  # agent notes may not be serializable; fail in this job rather than later
    return JobResult(id=job.id, values=msgspec.to_builtins(metrics), rollout=rollout)


def _opened_agent(choice: AgentChoice, stack: ExitStack, client_output: Path | None) -> Agent:
    """Open an agent, which `stack` closes. A HUGSIM client is started at its drive, and ends with it."""
    if choice.hugsim is None:
        detector = None if choice.detector is None else Path(choice.detector)
        options = AgentOptions(detector=detector, description=choice.description, url=choice.url)
        agent = open_agent(choice.name, options, trusted_only=True)
    else:
        client = choice.hugsim
        check_trusted(choice.title, [command_code(client.command)])
        if client_output is not None:
            client_output.parent.mkdir(parents=True, exist_ok=True)
        pipes = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="gsrain-hugsim-")))
        agent = HugsimAgent(
            pipes, client.command, client.channel_order, first_wait_s=client.wait_s,
            later_wait_s=min(client.wait_s, LATER_WAIT_S), output=client_output,
        )  # fmt: skip
    stack.callback(agent.close)
    return agent


def run_render_job(job: RenderJob, cache: WorkerCache, clips: Path) -> JobResult:
    """Render into a folder named by the job id, created atomically; an existing folder is kept as equal.

    Labels don't depend on rain: jobs that differ in nothing else draw them once, into a folder beside `clips`, and each
    clip has a copy.

    Raises ValueError for contradictory settings or missing scene parts, and OSError if writing fails.
    """
    scene = cache.scene(job.scene, job.scene_hash)
    place = clips / job.id
    rainfall = RainSimulation.start(job.rain)
    sequences = export_sequences(job.recording, scene, rainfall, _viewpoint(job, scene), in_scene_time=True)
    state = rainfall.state_at(job.recording.first_s)
    values: dict[str, Value] = {
        "cameras": len(sequences),
        "frames": len(frame_numbers(job.recording, sequences)),
        "sizes_px": ", ".join(sorted({f"{each.width}x{each.height}" for each in sequences.values()})),
        "implied_mm_h": float(state.implied_mm_h),
        "drops": int(state.drops),
    }
    clips.mkdir(parents=True, exist_ok=True)
    if not place.is_dir():
        labels = _shared_labels(job, scene, cache, clips.with_name(LABELS) / job.labels_id) if job.is_labeled else None
        try:
            with whole_folder(place, shared=True) as partial:
                _record(job, scene, cache, partial)
                if labels is not None:
                    shutil.copytree(labels, partial, dirs_exist_ok=True)
        except OSError:
            if not place.is_dir():  # otherwise another sweep wrote the same clip
                raise
    content = hashlib.sha256()
    for file in sorted(each for each in place.rglob("*") if each.is_file()):
        content.update(f"{file.relative_to(place).as_posix()}\0{file_hash(file)}\n".encode())
    values |= {"clip": f"{clips.name}/{job.id}", "clip_hash": content.hexdigest()[:16]}
    return JobResult(id=job.id, values=values)


def _shared_labels(job: RenderJob, scene: Scene, cache: WorkerCache, place: Path) -> Path:
    """Return the folder with the label files of a job; draws them unless another job has, and waits while one does."""
    while not place.is_dir():
        try:
            with whole_folder(place) as partial:
                _label(job, scene, cache, partial)
        except PathInUseError:
            time.sleep(_LOOK_EVERY_S)
        except OSError:
            if not place.is_dir():  # otherwise a process that sees no locks wrote the same
                raise
    return place


def _label(job: RenderJob, scene: Scene, cache: WorkerCache, folder: Path) -> None:
    """Write the label pass and the object labels of a clip, named as in the clip."""
    recording, sequences, numbers = _opened(job, scene, folder)
    renderer = cache.renderer(job.backend)
    if "labels" in recording.passes:
        alone = structs.replace(recording, passes=("labels",), twin=None)
        deque(export_frames(renderer, alone, sequences, numbers), maxlen=0)
    if job.labels is not None:
        deque(write_object_labels(renderer, job.labels, recording, sequences, numbers), maxlen=0)


def _record(job: RenderJob, scene: Scene, cache: WorkerCache, folder: Path) -> None:
    """Write a clip without its labels."""
    recording, sequences, numbers = _opened(job, scene, folder)
    renderer = cache.renderer(job.backend)
    if passes := tuple(each for each in recording.passes if each != "labels"):
        recording = structs.replace(recording, passes=passes)
        deque(export_frames(renderer, recording, sequences, numbers), maxlen=0)
    pictures = first_pictures(renderer, sequences, numbers[0])
    write_json(folder / "provenance.json", {name: msgspec.to_builtins(each) for name, each in pictures.items()})


def _opened(job: RenderJob, scene: Scene, folder: Path) -> tuple[ExportSettings, dict[str, FrameSequence], range]:
    """Return the recording of a job in a folder, and its frames by camera with their numbers."""
    recording = structs.replace(job.recording, output=str(folder / job.recording.output))
    rainfall = RainSimulation.start(job.rain)
    sequences = export_sequences(recording, scene, rainfall, _viewpoint(job, scene), in_scene_time=True)
    return recording, sequences, frame_numbers(recording, sequences)


def _viewpoint(job: RenderJob, scene: Scene) -> Camera | CameraPath:
    """Return the scene's camera path, else that of the rig camera that faces forward most."""
    if scene.path is not None:
        return scene.path.moved(scene.scene_to_world)
    mounted = [camera for rig in scene.rigs.values() for camera in rig]
    if not mounted or scene.ego is None:
        raise ValueError(f"scene {scene.name!r} has neither a camera path nor an ego vehicle with cameras")
    front = max(mounted, key=lambda each: each.camera_to_ego[0, 2])
    return rig_camera_path(scene, front, *(job.recording.size_px or (front.width, front.height)))
