"""One piece of a sweep: everything that its result depends on, and nothing else."""

import hashlib
from typing import Any

import msgspec
from msgspec import Struct

from gsrain_engine.backends import Backend
from gsrain_engine.rain.rain import Rain
from gsrain_engine.render.objects.label_format import LabelFormat
from gsrain_engine.render.recording import Recording

from ..scenario.scenario import Scenario
from .sweep import AgentChoice

_DIGITS = 20


class _Content(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What jobs of all kinds depend on."""

    program: str
    """Version of the program."""
    scene: str
    """As it was named; it stands in roll-outs."""
    scene_hash: str
    files: dict[str, str] = {}
    """Hashes of all other files that it reads, by the names under which it reads them."""
    packages: dict[str, str] = {}
    """Versions of other packages whose agent, scene formats or decoders it uses, by their names."""
    seed: int
    backend: Backend

    @property
    def id(self) -> str:
        """Hash of the content (20 hex digits): equal for equal jobs, on every machine."""
        return hashlib.sha256(msgspec.json.encode(self, order="sorted")).hexdigest()[:_DIGITS]


class DriveJob(_Content, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="drive"):
    """A closed-loop drive."""

    scenario: Scenario
    """As it is run: with its rain, its scene, and where its seed has it begin."""
    agent: AgentChoice

    @property
    def title(self) -> str:
        """What a person reads about it."""
        rain = self.scenario.rain.intensity_mm_h
        return f"{self.scenario.name}, {rain:g} mm/h, seed {self.seed}, {self.agent.title}"

    @property
    def parameters(self) -> dict[str, Any]:
        """What its row says about it."""
        return {
            **_shared(self, "drive"),
            "scenario": self.scenario.name,
            "intensity_mm_h": self.scenario.rain.intensity_mm_h,
            "agent": self.agent.title,
            "agent_name": self.agent.name,
        }


class RenderJob(_Content, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="render"):
    """A clip, or frames, with their labels."""

    rain: Rain
    recording: Recording
    labels: LabelFormat | None = None

    @property
    def title(self) -> str:
        """What a person reads about it."""
        return f"{self.scene}, {self.rain.intensity_mm_h:g} mm/h, seed {self.seed}"

    @property
    def parameters(self) -> dict[str, Any]:
        """What its row says about it."""
        return {**_shared(self, "render"), "intensity_mm_h": self.rain.intensity_mm_h, "labels": self.labels}


Job = DriveJob | RenderJob


def _shared(job: _Content, kind: str) -> dict[str, Any]:
    return {
        "id": job.id,
        "kind": kind,
        "scene": job.scene,
        "scene_hash": job.scene_hash,
        "seed": job.seed,
        "backend": job.backend,
        "program": job.program,
    }
