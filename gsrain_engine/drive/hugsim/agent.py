"""The agent that is somebody else: a driving stack that speaks HUGSIM's protocol, in a process of its own."""

import logging
from pathlib import Path

import numpy as np

from ..agents.agent import Needs, Plan
from ..agents.client_error import ClientError
from ..agents.observation import Observation, Rig
from .axes import HugsimWorld
from .client_process import ClientProcess
from .message import ChannelOrder, camera_params, hugsim_info, hugsim_obs
from .old_pickles import old_pickle
from .pipes import OBSERVATIONS, PLANS, Patience, Pipes
from .plan_frame import to_vehicle_frame
from .reply import MOST_BYTES, read_reply
from .setting import CAMERA_NAMES, all_six

_log = logging.getLogger(__name__)

FIRST_WAIT_S, LATER_WAIT_S = 120.0, 60.0
"""For the first plan, before which models are loaded, and for each one after."""
_LEAVE_WAIT_S = 100.0
"""HUGSIM waits as long for its client, which writes a video, once it has said that the drive is over."""
_SHORT_S = 2.0
"""To say so to a client that has given up and is likely to be gone."""


class HugsimAgent:
    """Lets a HUGSIM client (UniAD_SIM, VAD_SIM, NAVSIM's LTF, or a person's own) drive, unchanged.

    Per step it is sent `(obs, info)` through `obs_pipe` and answers through `plan_pipe`; "Done" tells it that the drive
    is over, upon which HUGSIM's clients end: each drive takes a new one. Drive in `in_hugsim_setting`, where HUGSIM's
    point of reference, the front camera, is ours too; with any other vehicle and rig `ego_pos` is still the front
    camera's place, `ego_box` the body's, and plans are turned into those of the rear axle (`to_vehicle_frame`).
    """

    name = "hugsim"

    def __init__(
        self,
        folder: Path,
        client_command: str | None = None,
        channel_order: ChannelOrder = "rgb",
        *,
        semantic: bool = False,
        depth: bool = False,
        first_wait_s: float = FIRST_WAIT_S,
        later_wait_s: float = LATER_WAIT_S,
    ) -> None:
        """Make ready to drive by the pipes in `folder`; without a command a person starts the client.

        `semantic` and `depth` are sent too when asked for: no known client reads them, and labels take several times
        as long to draw as pictures. Raises ClientError where there can be no pipes.
        """
        self.folder = folder.absolute()
        self._command, self._semantic, self._depth = client_command, semantic, depth
        self._channels: ChannelOrder = channel_order
        self._first_wait_s, self._later_wait_s = first_wait_s, later_wait_s
        self._pipes = Pipes(self.folder)
        self._client: ClientProcess | None = None
        self._drive: _Drive | None = None

    @property
    def needs(self) -> Needs:
        """All cameras of the rig, and what is to be sent beside their pictures."""
        return Needs(("all",), self._depth, self._semantic)

    @property
    def invitation(self) -> str:
        """What a person is told who starts the client."""
        return f"waiting for a HUGSIM client at {self.folder} ({OBSERVATIONS}, {PLANS})"

    def reset(self, seed: int, rig: Rig) -> None:
        """Begin a drive with a new client.

        Raises ValueError for a rig that is not HUGSIM's, ClientError where the client can't be started.
        """
        self._finish()
        self._drive = _Drive(rig)
        if self._command is not None:
            self._client = ClientProcess(self._command, self.folder)
        else:
            _log.info("%s", self.invitation)

    def plan(self, observation: Observation) -> Plan:
        """Return what the client plans; no points where it gives up.

        Raises ClientError where it is gone, silent, or answers what is no plan; the drive with it is over then.
        """
        drive = self._drive
        if drive is None:
            raise ClientError("there is no drive: reset the agent first")
        patience = Patience(self._first_wait_s if drive.world is None else self._later_wait_s, self._ended)
        try:
            self._pipes.send(self._message(drive, observation), patience)
            points = read_reply(self._pipes.receive(patience, MOST_BYTES))
        except BaseException:  # a person's Ctrl+C too: nobody waits for what hangs
            self._break_off()
            raise
        if points is None:
            drive.given_up = True
            return Plan(np.zeros((0, 2)), {"problem": "the client gave up: it answered None"})
        x, y = drive.cameras[CAMERA_NAMES[0]].camera_to_ego[:2, 3]
        return Plan(to_vehicle_frame(points, (float(x), float(y))))

    def close(self) -> None:
        """Say "Done" to the client, and wait until one that was started here has left."""
        self._finish()

    def _message(self, drive: "_Drive", observation: Observation) -> memoryview:
        if drive.world is None:
            drive.world = HugsimWorld.beginning(drive.rig, observation)
        obs = hugsim_obs(observation.views, drive.cameras, self._channels, self._semantic, self._depth)
        return old_pickle((obs, hugsim_info(observation, drive.rig, drive.world, drive.params)))

    def _ended(self) -> str | None:
        return None if self._client is None else self._client.ended

    def _finish(self) -> None:
        """End the drive under way, if there is one."""
        drive, self._drive = self._drive, None
        try:
            if drive is not None and drive.world is not None:
                leaves = self._say_done(drive)
                if leaves and self._client is not None:
                    self._client.wait(_LEAVE_WAIT_S)
        finally:
            self._break_off()

    def _say_done(self, drive: "_Drive") -> bool:
        """Tell the client that the drive is over; returns whether it is going to leave."""
        try:
            wait = _SHORT_S if drive.given_up else self._later_wait_s
            self._pipes.send(old_pickle("Done"), Patience(wait, self._ended))
        except ClientError as problem:
            if not drive.given_up:
                _log.warning("the drive is over, but %s", problem)
                return False
        return True

    def _break_off(self) -> None:
        """Let go of the drive, and of a client that was started here and still runs."""
        self._drive = None
        if self._client is not None:
            self._client.stop()
            self._client = None


class _Drive:
    """What belongs to one drive."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.cameras = all_six(rig.cameras)
        self.params = camera_params(self.cameras, rig)
        self.world: HugsimWorld | None = None
        """Known from the first observation on."""
        self.given_up = False
