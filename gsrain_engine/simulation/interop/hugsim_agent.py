"""HUGSIM agent: runs an external driving stack that uses HUGSIM's protocol, in its own process."""

import logging
import os
import re
import shlex
import shutil
import signal
import subprocess
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from ...safe_io.limits import open_file
from ..agents.base import Observation, Rig, SensorRequirements, Trajectory
from ..agents.http import ClientError
from . import hugsim_protocol as protocol
from .hugsim_pickle import old_pickle

_log = logging.getLogger(__name__)
FIRST_WAIT_S, LATER_WAIT_S = 120.0, 60.0
"""Timeouts for the first plan, which includes model loading, and for later ones."""

_LEAVE_WAIT_S = 100.0  # wait for the client, which writes a video, after "Done"; same as in HUGSIM
_SHORT_S = 2.0  # timeout of "Done" for a client that has failed
_START_S = 1.0  # time in which a command that can't work, such as a shell without its script, ends


class ClientStartError(ClientError):
    """The command of a client can't be run on this machine, for any drive."""


class HugsimAgent:
    """Lets an unmodified HUGSIM client (UniAD_SIM, VAD_SIM, NAVSIM's LTF, or a custom one) drive.

    Per step the client receives `(obs, info)` through `obs_pipe` and replies through `plan_pipe`; "Done" ends the drive
    and HUGSIM's clients, so each drive needs a new one. Use `with_hugsim_rig`, which makes HUGSIM's reference point,
    the front camera, the vehicle's; with any other vehicle and rig `ego_pos` is still the front camera's position,
    `ego_box` the body's, and plans are converted to the rear axle (`to_vehicle_frame`).
    """

    name = "hugsim"

    def __init__(
        self,
        folder: Path,
        client_command: str | None = None,
        channel_order: protocol.ChannelOrder = "rgb",
        *,
        semantic: bool = False,
        depth: bool = False,
        first_wait_s: float = FIRST_WAIT_S,
        later_wait_s: float = LATER_WAIT_S,
        output: Path | None = None,
    ) -> None:
        """Use the pipes in `folder`; without a command the user starts the client.

        The client's output goes to the file `output`, by default output.txt in the folder of the pipes. `semantic` and
        `depth` are optional: no known client reads them, and labels take several times as long to render as images.
        Raises ClientError if the pipes can't be created.
        """
        self.folder = folder.absolute()
        self._command, self._semantic, self._depth = client_command, semantic, depth
        self._output = output or self.folder / OUTPUT
        self._channels: protocol.ChannelOrder = channel_order
        self._first_wait_s, self._later_wait_s = first_wait_s, later_wait_s
        self._pipes = protocol.Pipes(self.folder)
        self.client: ClientProcess | None = None
        """Client that drives, or was started for the next drive."""
        self._drive: _HugsimDrive | None = None

    @property
    def needs(self) -> SensorRequirements:
        """All cameras of the rig and the optional outputs."""
        return SensorRequirements(("all",), self._depth, self._semantic)

    def start(self) -> None:
        """Start the client of the first drive early, so that it loads its model while the scene is read.

        Raises ClientError if the command can't be run, or ends at once.
        """
        if self._command is None or self.client is not None:
            return
        self.client = ClientProcess(self._command, self.folder, self._output)
        if self.client.wait(_START_S):
            raise ClientError(f"the client {self.client.ended} as soon as it was started")

    def reset(self, seed: int, rig: Rig) -> None:
        """Begin a drive with a new client, or with that of `start`.

        Raises ValueError for another rig, ClientError if the client can't start or has ended.
        """
        if self._drive is not None:
            self.close()
        self._drive = _HugsimDrive(rig)
        if self.client is not None:
            if (ended := self.client.ended) is not None:
                raise ClientError(f"the client {ended} before the drive began")
        elif self._command is not None:
            self.client = ClientProcess(self._command, self.folder, self._output)
        else:
            names = f"{protocol.OBSERVATIONS}, {protocol.PLANS}"
            _log.info("waiting for a HUGSIM client at %s (%s)", self.folder, names)

    def plan(self, observation: Observation) -> Trajectory:
        """Return the client's plan; without points if it gives up.

        Raises ClientError, which ends the drive, if it has ended, does not respond, or sends an invalid plan.
        """
        drive = self._drive
        if drive is None:
            raise ClientError("there is no drive: reset the agent first")
        wait_s = self._first_wait_s if drive.world is None else self._later_wait_s
        timeouts = protocol.Timeouts(wait_s, self._ended)
        try:
            if drive.world is None:
                drive.world = protocol.HugsimWorld.from_observation(drive.rig, observation)
            obs = protocol.hugsim_obs(observation.views, drive.cameras, self._channels, self._semantic, self._depth)
            info = protocol.hugsim_info(observation, drive.rig, drive.world, drive.params)
            self._pipes.send(old_pickle((obs, info)), timeouts)
            points = protocol.read_reply(self._pipes.receive(timeouts, protocol.MAX_BYTES))
        except BaseException:  # Ctrl+C too: do not leave a hanging client
            self._break_off()
            raise
        if points is None:
            drive.has_ended = True
            return Trajectory(np.zeros((0, 2)), {"problem": "the client gave up: it answered None"})
        x, y = drive.cameras[protocol.CAMERA_NAMES[0]].camera_to_ego[:2, 3]
        return Trajectory(to_vehicle_frame(points, (float(x), float(y))))

    def close(self) -> None:
        """Send "Done", and wait until a client started by this agent has ended."""
        drive, self._drive = self._drive, None
        try:
            if drive is not None and drive.world is not None and self._say_done(drive) and self.client is not None:
                self.client.wait(_LEAVE_WAIT_S)
        finally:
            self._break_off()

    def _ended(self) -> str | None:
        return None if self.client is None else self.client.ended

    def _say_done(self, drive: "_HugsimDrive") -> bool:
        """Send "Done"; returns whether the client is going to end."""
        try:
            wait = _SHORT_S if drive.has_ended else self._later_wait_s
            self._pipes.send(old_pickle("Done"), protocol.Timeouts(wait, self._ended))
        except ClientError as problem:
            if not drive.has_ended:
                _log.warning("the drive is over, but %s", problem)
                return False
        return True

    def _break_off(self) -> None:
        """Drop the drive, and stop a client started by this agent."""
        self._drive = None
        if self.client is not None:
            self.client.stop()
            self.client = None


class _HugsimDrive:
    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.cameras = protocol.six_hugsim_cameras(rig.cameras)
        self.params = protocol.camera_params(self.cameras, rig)
        self.world: protocol.HugsimWorld | None = None  # set at the first observation
        self.has_ended = False


_SAME_PLACE_M = 0.05


def to_vehicle_frame(plan: Float64[np.ndarray, "n 2"], front_m: tuple[float, float]) -> Float64[np.ndarray, "n 2"]:
    """Convert a plan of the front camera (x right, y forward) to one of the rear axle (x forward, y left).

    HUGSIM's reference point is the front camera, `front_m` (forward, left) of the rear axle; each plan starts at its
    own reference point. While the front moves in straight segments, the rear axle follows a tractrix: the
    angle d between heading and motion shrinks as tan(d / 2) exp(-length / wheelbase), with the camera's distance ahead
    of the axle as the wheelbase. If the camera is above the axle, as in HUGSIM's own setup, points keep their values.
    """
    forward = plan[:, ::-1] * (1.0, -1.0) + 0.0  # avoids -0
    ahead, left = front_m
    if ahead < _SAME_PLACE_M:
        return np.ascontiguousarray(forward)
    heading, before = 0.0, np.zeros(2)
    rear: list[np.ndarray] = []
    start = np.array([ahead, left])
    for point in forward:
        step = point - before
        length = float(np.hypot(*step))
        if length > 0:
            motion = float(np.arctan2(step[1], step[0]))
            apart = float(np.arctan2(np.sin(motion - heading), np.cos(motion - heading)))
            heading = motion - 2 * float(np.arctan(np.tan(apart / 2) * np.exp(-length / ahead)))
        cosine, sine = np.cos(heading), np.sin(heading)
        arm = np.array([cosine * ahead - sine * left, sine * ahead + cosine * left])
        rear.append(start + point - arm)
        before = point
    return np.array(rear)


def client_words(command: str) -> list[str]:
    """Split the command line of a client. Raises ClientError if it is empty or has an open quote."""
    try:
        words = shlex.split(command)
    except ValueError as problem:
        raise ClientError(f"the client's command {command!r} can't be read: {problem}") from None
    if not words:
        raise ClientError("the client's command is empty")
    return words


def missing_client_files(command: str) -> list[str]:
    """Name the program of a client's command, and the script that a shell or Python runs, if they are not there.

    Raises ClientError if the command can't be read.
    """
    program, *arguments = client_words(command)
    missing: list[str] = []
    if shutil.which(program) is None:
        missing.append(f"client {command!r}: there is no program {program}")
    if _INTERPRETER.fullmatch(Path(program).name):
        script = next((each for each in arguments if not each.startswith("-")), None)
        if script is not None and Path(script).suffix in _SCRIPTS and not Path(script).is_file():
            missing.append(f"client {command!r}: there is no script {script} in {Path.cwd()}")
    return missing


_INTERPRETER = re.compile(r"(ba|da|z|k)?sh|python[\d.]*")
_SCRIPTS = (".sh", ".zsh", ".bash", ".py")

OUTPUT = "output.txt"  # output file of the client, in the folder of the pipes as in HUGSIM
_TAIL_BYTES = 2000


class ClientProcess:
    """A client started with a command line: the folder of the pipes replaces {folder}, or is appended.

    HUGSIM's `zsh SCRIPT CUDA_ID OUTPUT_DIR` is written "zsh SCRIPT CUDA_ID".
    """

    def __init__(self, command: str, folder: Path, output: Path) -> None:
        """Start the client in its own session, with a file for its output. Raises ClientError on failure."""
        words = client_words(command)
        placed = [word.replace("{folder}", str(folder)) for word in words]
        placed += [] if any("{folder}" in word for word in words) else [str(folder)]
        self._output = output
        try:
            with output.open("wb") as stream:
                self._process = subprocess.Popen(
                    placed, stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT, start_new_session=True
                )
        except OSError as problem:
            reason = problem.strerror or problem
            raise ClientStartError(f"the client can't be started: {placed[0]}: {reason}") from None

    @property
    def ended(self) -> str | None:
        """Return the way it ended, as a clause with its last output; None while it runs."""
        code = self._process.poll()
        if code is None:
            return None
        killed_by = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        how = f"with exit code {code}" if code >= 0 else f"by {killed_by}"
        words = self._last_words()
        return f"ended {how}" + (f", its last words in {self._output}: {words!r}," if words else "")

    def wait(self, within_s: float) -> bool:
        """Return whether it ended by itself within a time."""
        try:
            self._process.wait(within_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def stop(self, within_s: float = 5.0) -> None:
        """Stop it and its children: terminate first, kill after a time."""
        if self._process.poll() is not None:
            return
        for each in (signal.SIGTERM, signal.SIGKILL):
            try:
                os.killpg(self._process.pid, each)
            except ProcessLookupError:
                break
            if self.wait(within_s):
                break
        self._process.wait()

    def _last_words(self) -> str:
        try:
            with open_file(self._output) as output:
                output.seek(max(0, os.fstat(output.fileno()).st_size - _TAIL_BYTES))
                lines = output.read(_TAIL_BYTES).decode(errors="replace").split("\n")
        except OSError:
            return ""
        return next((line.strip()[-300:] for line in reversed(lines) if line.strip()), "")
