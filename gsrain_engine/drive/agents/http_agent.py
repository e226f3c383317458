"""The agent that lives behind HTTP, in NeuroNCAP's form: UniAD and VAD as its model nodes, or a person's own."""

import time
from typing import Any

import msgspec

from gsrain_engine.untrusted.printable import printable

from .agent import Needs, Plan
from .client_error import ClientError
from .http_calls import HttpCalls
from .neuroncap_message import neuroncap_message
from .observation import Observation, Rig
from .plan_points import plan_points

ALIVE_WAIT_S, ANSWER_WAIT_S = 120.0, 60.0
"""For the server to come up, and for each answer."""
_TRY_S, _PAUSE_S = 5.0, 0.5
_MOST_OBJECTS = 100


class _Objects(msgspec.Struct, frozen=True):
    """What the stack saw, for the record: boxes x, y, length, width, yaw in the ego frame, with classes and scores."""

    objects_in_bev: list[list[float]] | None = None
    object_classes: list[str] | None = None
    object_scores: list[float] | None = None


class _Reply(msgspec.Struct, frozen=True):
    trajectory: list[list[float]]
    aux_outputs: _Objects | None = None


class HttpAgent:
    """Asks a server: `GET /alive` until it is there, `POST /reset` for a new drive, `POST /infer` for each plan.

    Its trajectory is x forward, y left, in metres, 0.5 s apart, of the rear axle: what a plan is here. Model nodes take
    pictures in nuScenes' own size and names: drive with the rig `nuscenes`, 1600 px wide, and steps of 0.5 s.
    """

    name = "http"
    needs = Needs(("all",))

    def __init__(self, url: str, alive_wait_s: float = ALIVE_WAIT_S, answer_wait_s: float = ANSWER_WAIT_S) -> None:
        """Make ready to ask the server at `url` (http://HOST:PORT). Raises ValueError where that is no address."""
        self._calls = HttpCalls(url)
        self._alive_wait_s, self._answer_wait_s = alive_wait_s, answer_wait_s
        self._rig: Rig | None = None

    def reset(self, seed: int, rig: Rig) -> None:
        """Begin a drive. Raises ClientError where the server does not come up or refuses."""
        until = time.monotonic() + self._alive_wait_s
        while True:
            try:
                self._calls.get("/alive", min(_TRY_S, self._alive_wait_s))
                break
            except ClientError as problem:
                if time.monotonic() + _PAUSE_S > until:
                    raise ClientError(f"nobody is there within {self._alive_wait_s:g} s: {problem}") from None
            time.sleep(_PAUSE_S)
        self._calls.post("/reset", b"{}", self._answer_wait_s)
        self._rig = rig

    def plan(self, observation: Observation) -> Plan:
        """Return what the server plans. Raises ClientError where it does not answer, or with what is no plan."""
        if self._rig is None:
            raise ClientError("there is no drive: reset the agent first")
        data = self._calls.post("/infer", neuroncap_message(observation, self._rig), self._answer_wait_s)
        return read_plan(data, self._calls.url)

    def close(self) -> None:
        """Nothing is held: the server waits for its next `/reset`."""


def read_plan(data: bytes, url: str) -> Plan:
    """Read what the server at `url` answers to `/infer`. Raises ClientError where it is no plan."""
    try:
        reply = msgspec.json.decode(data, type=_Reply)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as problem:
        raise ClientError(f"{url}/infer answers what is no plan: {printable(problem)}") from None
    return Plan(plan_points(reply.trajectory, url), _notes(reply.aux_outputs))


def _notes(seen: _Objects | None) -> dict[str, Any]:
    """What the stack saw, as plain values; nothing where it does not say."""
    if seen is None or not seen.objects_in_bev:
        return {}
    return {
        "objects_in_bev": seen.objects_in_bev[:_MOST_OBJECTS],
        "object_classes": (seen.object_classes or [])[:_MOST_OBJECTS],
        "object_scores": (seen.object_scores or [])[:_MOST_OBJECTS],
    }
