"""Checkpoints of PyTorch (`.pth`, `.pt`, `.ckpt`) as scenes; whose they are shows in the names of their tensors."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.safe_io.text_files import printable_line
from gsrain_engine.scene.formats import Format
from gsrain_engine.scene.formats.tensors import MISFITS, load_tensors, misfit
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.transforms import flatten_scene

from . import drivestudio, nerfstudio, single_model, street_gaussians

_LAYOUTS = (drivestudio, street_gaussians, nerfstudio, single_model)
_MAX_NAMES = 6


def read_checkpoint(path: Path) -> Gaussians:
    """Read all visible Gaussians of a checkpoint as at its first moment; see `read_checkpoint_scene`."""
    return flatten_scene(read_checkpoint_scene(path))


def read_checkpoint_scene(path: Path) -> Scene:
    """Read layers, sky and actors with their tracks. Only tensors and plain values are read: no code in it runs.

    Raises `SceneFormatError` if the file is damaged, holds anything else, or is of none of the layouts.
    """
    state = load_tensors(path)
    try:
        for layout in _LAYOUTS:
            if layout.matches(state):
                return layout.scene_of(path, state)
    except SceneFormatError:
        raise
    except MISFITS as error:
        raise misfit(path, error) from None
    raise SceneFormatError(
        path,
        "its tensors are no Gaussians of drivestudio, StreetGaussians, nerfstudio, MTGS, gsplat or 3DGS: it holds "
        f"{_contents(state)}. Export its Gaussians as a PLY",
    )


def _contents(state: Any) -> str:
    if not isinstance(state, Mapping):
        return type(state).__name__
    names = [printable_line(str(name)) for name in list(state)[: _MAX_NAMES + 1]]
    more = [*names[:_MAX_NAMES], "..."] if len(names) > _MAX_NAMES else names
    return ", ".join(more) or "nothing"


PTH = Format(
    ".pth",
    read_checkpoint,
    None,
    "checkpoints of drivestudio (OmniRe and its other models) and StreetGaussians, with actors and sky, and of 3DGS",
    read_scene=read_checkpoint_scene,
)
CKPT = Format(
    ".ckpt",
    read_checkpoint,
    None,
    "checkpoints of nerfstudio's splatfacto and of MTGS, with actors",
    read_scene=read_checkpoint_scene,
)
PT = Format(".pt", read_checkpoint, None, "checkpoints of gsplat's trainer", read_scene=read_checkpoint_scene)
