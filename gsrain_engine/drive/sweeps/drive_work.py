"""Does a drive of a sweep: what its row and its roll-out hold."""

from pathlib import Path

import msgspec

from ..agents.registry import AgentOptions, open_agent
from ..metrics.summary import measured
from ..road.drivable import drivable_of
from ..rollouts.rollout import Rollout
from ..simulation.drive import drive_through
from ..simulation.simulation import Simulation
from .job import DriveJob
from .outcome import Outcome
from .program import software
from .sweep import AgentChoice
from .workbench import Workbench


def do_drive(job: DriveJob, bench: Workbench) -> Outcome:
    """Drive from start to end. Raises whatever the scenario, the scene or the agent has against it."""
    scene = bench.scene(job.scene, job.scene_hash)
    agent = open_agent(job.agent.name, _options(job.agent), trusted_only=True)
    try:
        renderer = bench.renderer(job.backend) if agent.needs.cameras else None
        simulation = Simulation(job.scenario, scene, agent.needs, renderer, job.seed)
        rollout = _recorded(drive_through(simulation, agent), job)
        drivable = drivable_of(scene, simulation.ground, simulation.occupied)
        metrics = measured(rollout, simulation.occupied, drivable)
    finally:
        agent.close()
    msgspec.json.encode(rollout)  # what an agent notes down may be anything: here it is this job's fault
    return Outcome(id=job.id, values=msgspec.to_builtins(metrics), rollout=rollout)


def _recorded(rollout: Rollout, job: DriveJob) -> Rollout:
    return msgspec.structs.replace(rollout, scene_hash=job.scene_hash, software={**rollout.software, **software()})


def _options(choice: AgentChoice) -> AgentOptions:
    detector = None if choice.detector is None else Path(choice.detector)
    return AgentOptions(detector=detector, description=choice.description, url=choice.url)
