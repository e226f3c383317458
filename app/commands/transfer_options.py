"""The options of `gsrain transfer`: from where views are taken, how wet, and what a learned method does."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from gsrain_engine.appearance.methods import method_of
from gsrain_engine.appearance.transfer_settings import TransferSettings
from gsrain_engine.appearance.views.choice import Source, ViewChoice
from gsrain_engine.rain.wetness import wetness
from gsrain_engine.session.jobs.torch_extra import HOW_TO_GET_DIFFUSION, require_torch

from .converted_options import converted_options

_OPTIONS = {"source": "views", "width_px": "width", "side_px": "side", "tile_px": "tile", "sensors": "cameras"}
_MOST_MM_H = 100.0


@Parameter(name="*")  # its fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """Which views."""

    views: Annotated[
        Source,
        Parameter(help="Of a scene: recorded (see --capture), rig (along the ego's way), path, around; auto chooses."),
    ] = "auto"
    capture: Annotated[Path | None, Parameter(help="Where a scene's recorded cameras come from.")] = None
    count: Annotated[int | None, Parameter(help="Number of views, evenly; default: 24, of a recording all.")] = None
    cameras: Annotated[str, Parameter(help="Only these cameras of the rig or recording, commas between.")] = ""
    width: Annotated[
        int | None,
        Parameter(help="Width of pictures in px; a capture's are never enlarged. Default: their own, at most 960."),
    ] = None

    @property
    def choice(self) -> ViewChoice:
        """The same as a value; raises ValueError, which names the option, where it is out of bounds."""
        sensors = tuple(name.strip() for name in self.cameras.split(",") if name.strip())
        return converted_options(
            {"source": self.views, "count": self.count, "width_px": self.width, "sensors": sensors},
            ViewChoice,
            _OPTIONS,
        )


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class MethodOptions:
    """What becomes of them."""

    method: Annotated[
        str,
        Parameter(
            help="wet: computed, no weights; cyclegan-turbo: the paper's model; images: --images; or a package's."
        ),
    ] = "wet"
    rain: Annotated[float | None, Parameter(help="wet: as wet as steady rain of so many mm/h makes things.")] = None
    wetness: Annotated[
        float | None, Parameter(help="wet: 0 dry, 1 soaked; default 1, which gsrain recolor makes wet colours of.")
    ] = None
    seed: Annotated[int, Parameter(help="wet: chooses where puddles stand, and clouds.")] = 0
    images: Annotated[
        Path | None, Parameter(help="images: folder with pictures, matched by name: SENSOR/NAME or NAME.")
    ] = None
    weights: Annotated[
        Path | None, Parameter(help="cyclegan-turbo: file with its weights, else see gsrain doctor.")
    ] = None
    base: Annotated[Path | None, Parameter(help="cyclegan-turbo: SD-Turbo's folder, else see gsrain doctor.")] = None
    normals: Annotated[
        Literal["depth", "dsine", "marigold", "none"], Parameter(help="cyclegan-turbo: who tells surface normals.")
    ] = "depth"
    no_normals: Annotated[bool, Parameter(help="cyclegan-turbo: as --normals none.", negative="")] = False
    normals_weights: Annotated[Path | None, Parameter(help="File of DSINE, or folder of Marigold.")] = None
    normals_checkout: Annotated[Path | None, Parameter(help="Your own copy of DSINE's program.")] = None
    guide: Annotated[
        Literal["up", "luma"], Parameter(help="cyclegan-turbo: how normals become one channel; luma as in the paper.")
    ] = "up"
    mutual_attention: Annotated[
        bool, Parameter(help="cyclegan-turbo: whether each view attends to its neighbours.")
    ] = True
    neighbours: Annotated[int, Parameter(help="cyclegan-turbo: to how many.")] = 2
    side: Annotated[int, Parameter(help="cyclegan-turbo: shorter side in px of what it sees.")] = 512
    tile: Annotated[int | None, Parameter(help="cyclegan-turbo: side in px of tiles; default: in one piece.")] = None
    device: Annotated[Literal["auto", "cpu", "cuda"], Parameter(help="cyclegan-turbo: where it runs.")] = "auto"
    precision: Annotated[
        Literal["float32", "float16", "bfloat16"],
        Parameter(help="cyclegan-turbo: of its numbers; bfloat16 blurs what one step amplifies."),
    ] = "float32"

    @property
    def settings(self) -> TransferSettings:
        """The same as a value; raises ValueError, which names the option, for what does not go."""
        if self.no_normals and self.normals not in ("depth", "none"):
            raise ValueError(f"--no-normals and --normals {self.normals} exclude each other")
        return converted_options(
            {
                "wetness": self._wetness(), "seed": self.seed, "images": self.images, "weights": self.weights,
                "base": self.base, "normals": "none" if self.no_normals else self.normals,
                "normals_weights": self.normals_weights, "normals_checkout": self.normals_checkout,
                "guide": self.guide, "mutual_attention": self.mutual_attention, "neighbours": self.neighbours,
                "side_px": self.side, "tile_px": self.tile, "device": self.device, "precision": self.precision,
            }, TransferSettings, _OPTIONS,
        )  # fmt: skip

    def check(self) -> None:
        """Raise ValueError for what would be found out later: a file or torch is missing."""
        method = method_of(self.method)
        if method.needs is not None and getattr(self, method.needs) is None:
            raise ValueError(f"--method {self.method} needs --{method.needs}")
        for name in ("weights", "base", "images", "normals_weights", "normals_checkout"):
            path: Path | None = getattr(self, name)
            if path is not None and not path.exists():
                raise ValueError(f"--{name.replace('_', '-')} {path}: no such file or folder")
        if method.needs_torch:
            require_torch(f"--method {self.method}", HOW_TO_GET_DIFFUSION)

    def _wetness(self) -> float:
        if self.rain is None:
            return 1.0 if self.wetness is None else self.wetness
        if self.wetness is not None:
            raise ValueError("--rain and --wetness exclude each other")
        if not 0 <= self.rain <= _MOST_MM_H:
            raise ValueError(f"--rain {self.rain:g}: must be within 0..{_MOST_MM_H:g} mm/h")
        return wetness(self.rain)
