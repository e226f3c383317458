"""Who drives, on the command line."""

from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from gsrain_engine.drive.agents.agent import Agent
from gsrain_engine.drive.agents.agent_file import agent_file
from gsrain_engine.drive.agents.registry import AgentOptions, agent_names, default_agent, open_agent
from gsrain_engine.drive.scenario.scenario import Scenario
from gsrain_engine.scene.scene import Scene

from ...console import print

HUGSIM = "hugsim"
"""Not in the registry: it takes a folder of pipes, and changes scene and scenario."""


@Parameter(name="*")  # its fields are options of the command, without a prefix
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
        """Return who is asked for; raises ValueError where that can't be."""
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
        """Return scenario and scene as the driver needs them: HUGSIM's clients know one rig and one vehicle."""
        if self.hugsim_dir is None:
            return scenario, scene
        from gsrain_engine.drive.hugsim.setting import in_hugsim_setting

        return in_hugsim_setting(scenario, scene)

    @contextmanager
    def opened(self) -> Generator[list[Agent]]:
        """Open all agents for as long as the block runs; says so where one stands in for another."""
        with ExitStack() as stack:
            agents = [self._open(name) for name in self.names()] or [self._usual()]
            for agent in agents:
                stack.callback(agent.close)
            yield agents

    def _open(self, name: str) -> Agent:
        if name != HUGSIM:
            return open_agent(name, self._given)
        if self.hugsim_dir is None:
            raise ValueError("--agent hugsim takes the folder of its pipes: --hugsim-dir DIR")
        from gsrain_engine.drive.hugsim.agent import LATER_WAIT_S, HugsimAgent

        first_s, later_s = self.hugsim_wait, min(self.hugsim_wait, LATER_WAIT_S)
        return HugsimAgent(
            self.hugsim_dir, self.hugsim_client, self.channel_order, semantic=self.hugsim_all, depth=self.hugsim_all,
            first_wait_s=first_s, later_wait_s=later_s,
        )  # fmt: skip

    def _usual(self) -> Agent:
        name, reason = default_agent(self._given)
        if reason is not None:
            print(reason)
        return open_agent(name, self._given)

    @property
    def _given(self) -> AgentOptions:
        return AgentOptions(self.detector, self.description, self.url)
