"""The options of `gsrain render`: rain, and how a clip is recorded."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from cyclopts import Parameter

from gsrain_engine.rain.presets import load_preset
from gsrain_engine.rain.rain import Rain
from gsrain_engine.render.recording import Codec, Recording
from gsrain_engine.scene.scene import Scene
from gsrain_engine.untrusted.explained_errors import converted

from .converted_options import RAIN_OPTIONS, converted_options

_RECORDING_OPTIONS = {"size_px": "size", "first_s": "from", "last_s": "to"}


@Parameter(name="*")  # its fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class RainOptions:
    """Rain on the command line."""

    rain: Annotated[float | None, Parameter(help="Rainfall intensity in mm/h, 0..100; calibrated up to 13.")] = None
    preset: Annotated[
        str | None, Parameter(help="clear, 1.2, 8.5, 12.0, paper, or a preset file; other options go on top.")
    ] = None
    seed: Annotated[int | None, Parameter(help="Same seed and time, same drops.")] = None
    exposure: Annotated[float | None, Parameter(help="Shutter time in seconds; default: the camera's own.")] = None
    closure: Annotated[
        Literal["density", "published"] | None,
        Parameter(help="density: as many drops as the intensity needs; published: the paper's table as it is."),
    ] = None
    calibration: Annotated[
        str | None, Parameter(help="Name of a shipped calibration, or a file that gsrain calibrate wrote.")
    ] = None
    roofs: Annotated[bool | None, Parameter(help="Keep rain from under bridges, canopies and trees.")] = None
    haze: Annotated[bool | None, Parameter(help="Draw far drops as haze.")] = None
    streaks: Annotated[bool | None, Parameter(help="Draw near drops as streaks.")] = None
    wetness: Annotated[
        float | None,
        Parameter(help="Share of the scene's wet colours, 0 clear to 1 soaked; default: as the intensity has it."),
    ] = None

    def for_scene(self, scene: Scene) -> Rain:
        """Preset, else the rain saved with the scene, else none; then what was asked for on top."""
        if self.preset is not None:
            rain = load_preset(self.preset)
        else:
            rain = converted(scene.rain, Rain) if scene.rain is not None else Rain()
        asked = {
            "intensity_mm_h": self.rain,
            "seed": self.seed,
            "exposure_s": self.exposure,
            "closure": self.closure,
            "calibration": self.calibration,
            "roofs": self.roofs,
            "haze": self.haze,
            "streaks": self.streaks,
            "wetness": self.wetness,
        }
        values = msgspec.to_builtins(rain) | {name: value for name, value in asked.items() if value is not None}
        return converted_options(values, Rain, RAIN_OPTIONS)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """How a clip is recorded, on the command line."""

    fps: Annotated[float, Parameter(help="Frames a second.")] = 30.0
    time: Annotated[float, Parameter(name=["--time", "--from"], help="Moment of the first frame in seconds.")] = 0.0
    to: Annotated[float | None, Parameter(help="Moment at which the clip ends, in seconds.")] = None
    supersampling: Annotated[int, Parameter(help="Draw 1..4 times wider and higher, and take the mean.")] = 1
    motion_blur: Annotated[
        int, Parameter(help="Sub-frames (1..64) over the exposure T, with T/k each, averaged in linear light.")
    ] = 1
    cameras: Annotated[
        str, Parameter(help="Rig cameras instead of a path: RIG, RIG/NAME, NAME or all; several with commas.")
    ] = ""
    passes: Annotated[
        str, Parameter(help="color, depth (16 bit, cm), alpha, labels (layer or actor of each pixel); with commas.")
    ] = "color"
    twin: Annotated[bool, Parameter(help="Also the same clip at 0 mm/h, called NAME.clear.")] = False
    codec: Annotated[
        Codec,
        Parameter(
            help="auto goes by the ending: h264 in MP4, vp9 in WebM, png in folders, which may hold jpeg or exr too."
        ),
    ] = "auto"
    quality: Annotated[
        int | None,
        Parameter(help="Rate factor, lower is better: 0..51 (h264), 0..63 (vp9, av1); JPEG: 1..100, higher is better."),
    ] = None

    def recording(self, output: Path, size_px: tuple[int, int] | None, *, depth: bool) -> Recording:
        """Check everything; raises `ValueError` for what is out of bounds or contradicts itself."""
        if not 0.1 <= self.fps <= 1000:
            raise ValueError(f"--fps {self.fps:g}: must be within 0.1..1000")
        passes = _words(self.passes)
        values: dict[str, Any] = {
            "output": str(output),
            "size_px": size_px,
            "fps": self.fps,
            "first_s": self.time,
            "last_s": self.to,
            "supersampling": self.supersampling,
            "motion_blur": self.motion_blur,
            "cameras": _words(self.cameras),
            "passes": [*passes, "depth"] if depth and "depth" not in passes else passes,
            "twin": self.twin,
            "codec": self.codec,
            "quality": self.quality,
        }
        return converted_options(values, Recording, _RECORDING_OPTIONS)


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]
