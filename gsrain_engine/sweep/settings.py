"""Sweep settings, their YAML files, and the jitter of initial conditions."""

import zlib
from itertools import product
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, structs

from ..choices import LAMP_WORDS, Backend, LabelFormat
from ..evaluation.attribution.factors import factor_names, is_attributed
from ..evaluation.detection.description import description_names
from ..presets import load_config, shipped_config_names
from ..rain.calibration import calibration_names
from ..rain.settings import HEAVIEST_MM_H, RainSettings, load_preset
from ..rain.wetness import with_wet_choice
from ..render.export_settings import ExportSettings
from ..safe_io.errors import convert_checked
from ..scene.built_in import DEFAULT_SCENE
from ..scene.sensor import load_sensor, sensor_names
from ..settings import Settings
from ..simulation.agents.registry import HUGSIM, agent_names
from ..simulation.friction import Friction
from ..simulation.scenario import Scenario
from ..simulation.scenario_io import scenario_names

_FOLDER = "sweeps"
_FILES = (
    "scenarios", "scenes", "agents", "name", "detector", "description", "calibration", "preset", "sensor", "lamps",
)  # fmt: skip
"""Fields that hold file names; `name` is an agent's."""

Intensities = Annotated[
    tuple[Annotated[float, Meta(ge=0, le=HEAVIEST_MM_H)], ...],
    Meta(min_length=1, title="Intensities", extra={"unit": "mm/h"}),
]
DrawnBy = Annotated[Backend, Meta(title="Back end", extra={"commands": "sweep"},
                                  description="Renderer; cpu gives the same bytes on every machine.")]  # fmt: skip
OutputFolder = Annotated[str | None, Meta(title="Output", description="Folder of rows, tables and clips.",
                                          extra={"option": "output o", "path": True, "commands": "sweep"})]  # fmt: skip
Seed = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Seeds = Annotated[int, Meta(ge=1, le=100_000)] | Annotated[tuple[Seed, ...], Meta(min_length=1)]


class HugsimClient(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A driving stack that runs elsewhere and speaks HUGSIM's protocol: UniAD, VAD or LTF, started for each drive."""

    command: Annotated[str, Meta(
        min_length=1, title="Command",
        description="Starts the client; the folder of its pipes is appended, or replaces {folder}.")]  # fmt: skip
    channel_order: Annotated[Literal["rgb", "bgr"], Meta(title="Channel order", description="Of the images.")] = "rgb"
    wait_s: Annotated[float, Meta(
        gt=0, le=86_400, title="Wait", extra={"unit": "s"},
        description="For the first plan; at most 60 s of it for each later one.")] = 120.0  # fmt: skip


class AgentChoice(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An agent with its options."""

    name: Annotated[str, Meta(min_length=1, title="Name", description="Of those of gsrain drive --agent.")] = HUGSIM
    hugsim: Annotated[
        HugsimClient | None, Meta(title="HUGSIM client", description="Instead of a name: a client by its command.")
    ] = None
    label: Annotated[str | None, Meta(title="Label", description="Name in tables; none: name and detector.")] = None
    detector: Annotated[str | None, Meta(title="Detector", description="Its ONNX file.")] = None
    description: Annotated[
        str | None, Meta(title="Description", description="A shipped detector description or a YAML file.")
    ] = None
    url: Annotated[str | None, Meta(title="URL", description="URL of a driving agent that runs elsewhere.")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.name == HUGSIM) != (self.hugsim is not None):
            raise ValueError("an agent has either a name or `hugsim: {command: ...}`")

    @property
    def title(self) -> str:
        files = [self.name] if self.detector is None else [self.name, Path(self.detector).stem]
        return self.label or " ".join(Path(each).name for each in files)


# Jitter: seeds vary initial positions and speeds, so that runs differ even without rain


class Jitter(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Standard deviations of normal distributions truncated at two sigma."""

    ego_speed_m_s: Annotated[float, Meta(ge=0, le=10, title="Ego's speed", extra={"unit": "m/s"})] = 0.0
    ahead_m: Annotated[
        float, Meta(ge=0, le=20, title="Ahead", description="Of each road user.", extra={"unit": "m"})
    ] = 0.0
    left_m: Annotated[float, Meta(ge=0, le=5, title="Left", description="Of each road user.", extra={"unit": "m"})] = (
        0.0
    )
    speed_m_s: Annotated[
        float, Meta(ge=0, le=10, title="Speed", description="Of each road user that moves.", extra={"unit": "m/s"})
    ] = 0.0


# Variants: further axes of a sweep

Speeds = tuple[Annotated[float, Meta(ge=0, le=60)], ...]
Gaps = tuple[Annotated[float, Meta(ge=0, le=500)], ...]
Scales = tuple[Annotated[float, Meta(ge=0.25, le=4)], ...]
Exposures = tuple[Annotated[float, Meta(ge=1e-5, le=1.0)], ...]


class Variant(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """One choice on each further axis of a sweep of drives; None is what the scenario says."""

    wet: bool | None = None
    preset: str | None = None
    sensor: str | None = None
    mirror: bool | None = None
    splashes: bool | None = None
    spray: bool | None = None
    friction: Friction | None = None
    exposure_s: float | None = None
    diameter_scale: float | None = None
    start_speed_m_s: float | None = None
    gap_m: float | None = None

    @property
    def title(self) -> str:
        """Words that name the choices; empty for those of the scenario."""
        words = [] if self.wet is None else ["wet" if self.wet else "as lit"]
        words += [] if self.preset is None else [f"preset {Path(self.preset).stem}"]
        words += [] if self.sensor is None else [f"sensor {Path(self.sensor).stem}"]
        words += [] if self.mirror is None else ["mirror" if self.mirror else "no mirror"]
        words += [] if self.splashes is None else ["splashes" if self.splashes else "no splashes"]
        words += [] if self.spray is None else ["spray" if self.spray else "no spray"]
        words += [] if self.friction is None else [f"{self.friction} friction"]
        words += [] if self.exposure_s is None else [f"{1000 * self.exposure_s:g} ms"]
        words += [] if self.diameter_scale is None else [f"diameters x{self.diameter_scale:g}"]
        words += [] if self.start_speed_m_s is None else [f"{self.start_speed_m_s:g} m/s"]
        words += [] if self.gap_m is None else [f"{self.gap_m:g} m"]
        return ", ".join(words)

    def of(self, scenario: Scenario) -> Scenario:
        """Return the scenario with these choices, before its start is varied by a seed."""
        rain, users = scenario.rain, scenario.road_users
        if self.preset is not None:
            rain = load_preset(self.preset)
        if self.sensor is not None:
            load_sensor(self.sensor)  # raises for a missing or wrong one before the first drive
            rain = structs.replace(rain, sensor=self.sensor)
        if self.mirror is not None:
            rain = structs.replace(rain, mirror=self.mirror)
        if self.splashes is not None:
            rain = structs.replace(rain, splashes=self.splashes)
        if self.spray is not None:
            rain = structs.replace(rain, spray=self.spray)
        if self.exposure_s is not None:
            rain = structs.replace(rain, exposure_s=self.exposure_s)
        if self.diameter_scale is not None:
            rain = structs.replace(rain, diameter_scale=self.diameter_scale)
        if self.gap_m is not None:
            if not users:
                raise ValueError(f"scenario {scenario.name!r}: gap_m varies its first road user, and it has none")
            users = (structs.replace(users[0], ahead_m=self.gap_m), *users[1:])
        rain = with_wet_choice(rain, self.wet)
        speed = scenario.speed_m_s if self.start_speed_m_s is None else self.start_speed_m_s
        friction = self.friction or scenario.friction
        return structs.replace(scenario, rain=rain, road_users=users, speed_m_s=speed, friction=friction)


class DriveSweep(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="drive"):
    """Closed-loop drives. A seed has the same effect at every intensity, so that results form pairs."""

    scenarios: Annotated[
        tuple[str, ...], Meta(min_length=1, title="Scenarios", description="Shipped names, or scenario files.")
    ]
    intensities_mm_h: Intensities = (0.0, 1.2, 8.5, 12.0)
    agents: Annotated[
        tuple[str | AgentChoice, ...],
        Meta(min_length=1, title="Agents", description="Names, or names with a detector, its description, a URL."),
    ] = ("oracle-idm",)
    seeds: Annotated[
        Seeds, Meta(title="Seeds", description="A number of seeds (0, 1, ...) or a list, for drops, agents and jitter.")
    ] = 20
    scenes: Annotated[
        tuple[str, ...], Meta(title="Scenes", description="None takes the scene that each scenario names.")
    ] = ()
    jitter: Annotated[Jitter, Meta(title="Jitter", description="Variation of the start by seeds other than 0.")] = (
        Jitter()
    )
    wet: Annotated[
        tuple[bool | None, ...],
        Meta(
            min_length=1,
            title="Wet",
            description="true: overcast and wet, computed if the scene has no wet colors. false: as lit. null: as "
            "the rain, where the scene has them. Several are compared.",
        ),
    ] = (None,)
    preset: Annotated[
        tuple[str, ...], Meta(title="Presets", description="Rain presets to compare; none: the scenario's rain.")
    ] = ()
    sensor: Annotated[
        tuple[str, ...], Meta(title="Sensors", description="Names or files, to compare; none: the scenario's.")
    ] = ()
    mirror: Annotated[
        tuple[bool | None, ...],
        Meta(
            min_length=1, title="Reflections", description="Whether water on the ground reflects; null: the scenario's."
        ),
    ] = (None,)
    splashes: Annotated[
        tuple[bool | None, ...],
        Meta(min_length=1, title="Splashes", description="Splashes and rings, or none; null: the scenario's."),
    ] = (None,)
    spray: Annotated[
        tuple[bool | None, ...],
        Meta(min_length=1, title="Spray", description="Whether vehicles throw spray; null: the scenario's."),
    ] = (None,)
    friction: Annotated[
        tuple[Friction, ...], Meta(title="Friction", description="dry or wet, to compare; none: the scenario's.")
    ] = ()
    exposure_s: Annotated[
        Exposures, Meta(title="Exposures", description="None: the scenario's.", extra={"unit": "s"})
    ] = ()
    diameter_scale: Annotated[
        Scales, Meta(title="Drop sizes", description="Factors on all diameters, at equal mm/h. None: the scenario's.")
    ] = ()
    start_speed_m_s: Annotated[
        Speeds, Meta(title="Start speeds", description="Of the ego (V0). None: the scenario's.", extra={"unit": "m/s"})
    ] = ()
    gap_m: Annotated[
        Gaps,
        Meta(title="Gaps", description="To the first road user (d). None: the scenario's.", extra={"unit": "m"}),
    ] = ()
    attribute: Annotated[
        tuple[str, ...],
        Meta(
            title="Attribute",
            extra={"commands": "sweep"},
            description="Also drive with parts of the rain, for the share of each in its effect: all that it has, or "
            f"those of a list, of which it then consists ({', '.join(factor_names())}).",
        ),
    ] = ()
    backend: DrawnBy = "auto"
    output: OutputFolder = None

    def __post_init__(self) -> None:
        super().__post_init__()
        is_attributed(self.attribute)  # raises for an unusable choice

    @property
    def variants(self) -> list[Variant]:
        """All combinations of the further axes."""
        axes = {name: getattr(self, name) or (None,) for name in Variant.__struct_fields__}
        return [Variant(**dict(zip(axes, values, strict=True))) for values in product(*axes.values())]


class RenderSweep(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="render"):
    """Videos or images with labels, as a data set. Labels are the same at every intensity."""

    recording: Annotated[
        ExportSettings,
        Meta(
            title="Recording", description="As gsrain render takes it; its output is a name in the clip's own folder."
        ),
    ]
    scenes: Annotated[tuple[str, ...], Meta(min_length=1, title="Scenes")] = ("street",)
    intensities_mm_h: Intensities = (0.0, 1.2, 8.5, 12.0)
    seeds: Annotated[Seeds, Meta(title="Seeds", description="A number of seeds (0, 1, ...) or a list, for drops.")] = 1
    rain: Annotated[RainSettings, Meta(title="Rain", description="Everything but intensity and seed.")] = RainSettings()
    sensor: Annotated[
        tuple[str, ...], Meta(title="Sensors", description="Names or files, to compare; none: the rain's.")
    ] = ()
    labels: Annotated[
        LabelFormat | None, Meta(title="Labels", description="coco or kitti; needs a scene with actors.")
    ] = None
    backend: DrawnBy = "auto"
    output: OutputFolder = None


Sweep = DriveSweep | RenderSweep


def seeds_of(sweep: Sweep) -> tuple[int, ...]:
    """Return the seeds of a sweep without duplicates."""
    return tuple(range(sweep.seeds)) if isinstance(sweep.seeds, int) else tuple(dict.fromkeys(sweep.seeds))


def sweep_names() -> list[str]:
    return shipped_config_names(_FOLDER)


def load_sweep(name: str | Path) -> Sweep:
    """Load a shipped sweep by name, or a sweep file by path.

    File names are resolved against the folder of the sweep file first, then the working folder; `output` only against
    the latter. Raises ValueError with the file, the field and what is allowed.
    """
    known = {
        HUGSIM,
        DEFAULT_SCENE,
        *shipped_config_names("rain"),
        *scenario_names(),
        *agent_names(),
        *description_names(),
        *calibration_names(),
        *sensor_names(),
        *LAMP_WORDS,
    }
    values = load_config(_FOLDER, name, object, "sweep", _FILES, known)
    try:
        return convert_checked(values, Sweep)
    except ValueError as error:
        raise ValueError(f"sweep {name}: {error}") from None


_MAX_SIGMAS = 2.0
_FASTEST_M_S = 60.0


def apply_jitter(scenario: Scenario, jitter: Jitter, seed: int) -> Scenario:
    """Return a scenario with the initial conditions of a seed. Seed 0 leaves it unchanged.

    The result depends on neither rain nor agent: drives of one seed start alike at every intensity.
    """
    if seed == 0:
        return scenario
    random = np.random.default_rng([seed, zlib.crc32(scenario.name.encode())])

    def draw(sigma: float) -> float:
        """Draw also if sigma is 0, so that one deviation does not affect the others."""
        return sigma * float(np.clip(random.standard_normal(), -_MAX_SIGMAS, _MAX_SIGMAS))

    speed = _speed(scenario.speed_m_s + draw(jitter.ego_speed_m_s))
    users = tuple(
        structs.replace(
            user,
            ahead_m=user.ahead_m + draw(jitter.ahead_m),
            left_m=user.left_m + draw(jitter.left_m),
            speed_m_s=_speed(user.speed_m_s + draw(jitter.speed_m_s)) if user.speed_m_s > 0 else draw(0.0),
        )
        for user in scenario.road_users
    )
    return structs.replace(scenario, speed_m_s=speed, road_users=users)


def _speed(value: float) -> float:
    return float(np.clip(value, 0.0, _FASTEST_M_S))
