"""DSINE's files on the user's machine, and its network, built from a local checkout, without downloads."""

import os
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import platformdirs

from ..trusted_code import Code, check_named, check_unchanged, importable, read_code

WEIGHTS_PLACE = "GSRAIN_DSINE_WEIGHTS"
"""Environment variable with DSINE's file of weights."""
CHECKOUT_PLACE = "GSRAIN_DSINE"
"""Environment variable with the folder of DSINE's program."""
_PROGRAMS = ("dsine.py", "dsine/v02.py")
_PACKAGES = ("models", "utils")
"""Packages of the checkout; their names are so common that they must not stay importable."""


def find_dsine_weights(file: Path | None = None) -> Path:
    """Find DSINE's weights: `file`, else that of GSRAIN_DSINE_WEIGHTS, else dsine/dsine.pt in the user's data folder.

    Raises FileNotFoundError with the place searched, and how to get them.
    """
    named = file or os.environ.get(WEIGHTS_PLACE)
    place = Path(named) if named else _dsine_folder() / "dsine.pt"
    if place.is_file():
        return place
    raise FileNotFoundError(
        f"no weights of DSINE at {place}: put dsine.pt (https://huggingface.co/camenduru/DSINE, for non-commercial use "
        f"only) there, or name a file by --normals-weights FILE (normals_weights) or {WEIGHTS_PLACE}"
    )


def find_dsine_checkout(folder: Path | None = None) -> Path:
    """Find DSINE's program: `folder`, else that of GSRAIN_DSINE, else dsine/DSINE in the user's data folder.

    Raises FileNotFoundError with the place searched, and how to get it.
    """
    named = folder or os.environ.get(CHECKOUT_PLACE)
    place = Path(named) if named else _dsine_folder() / "DSINE"
    if is_dsine_checkout(place):
        return place
    raise FileNotFoundError(
        f"no program of DSINE (models/dsine) at {place}: git clone https://github.com/baegwangbin/DSINE (for "
        f"non-commercial use only) there, or name a copy by --normals-checkout DIR (normals_checkout) or "
        f"{CHECKOUT_PLACE}"
    )


def is_dsine_checkout(folder: Path) -> bool:
    return any((folder / "models" / file).is_file() for file in _PROGRAMS)


def has_geffnet() -> bool:
    """True if the package of DSINE's encoder is installed."""
    return "geffnet" in sys.modules or find_spec("geffnet") is not None


def _dsine_folder() -> Path:
    return platformdirs.user_data_path("gsrain", appauthor=False) / "dsine"


def checkout_code(checkout: Path) -> Code:
    """Read all Python code that the checkout's files import from it."""
    return read_code(checkout, _PACKAGES)


def check_checkout(named_by: str | Path, normals: str | None, checkout: Path | str | None) -> None:
    """Raise `UntrustedCodeError` if the settings of a file would run code that the user has not allowed."""
    if normals == "dsine" and checkout is not None:
        check_named(named_by, Path(checkout), _PACKAGES)


def dsine_module(checkout: Path, estimates_uncertainty: bool = False) -> Any:
    """Return DSINE without weights, as `torch.nn.Module`, from either layout of its repository.

    Raises ValueError if the folder is not DSINE's code or `geffnet` is not installed, and `UntrustedCodeError` if a
    file named the folder and the user has not allowed its content.
    """
    if not is_dsine_checkout(checkout):
        raise ValueError(f"{checkout}: not DSINE's program: it has neither models/dsine/v02.py nor models/dsine.py")
    code = checkout_code(checkout)
    check_unchanged(code)
    with importable(code):
        try:
            return _built(checkout, estimates_uncertainty)
        except ModuleNotFoundError as error:
            raise ValueError(f"DSINE in {checkout} needs {error.name}: pip install {error.name}") from None


_PUBLISHED = SimpleNamespace(
    NNET_encoder_B=5, NNET_decoder_NF=2048, NNET_decoder_BN=False, NNET_decoder_down=8, NNET_learned_upsampling=True,
    NNET_output_dim=3, NNET_feature_dim=64, NNET_hidden_dim=64, NRN_prop_ps=5, NRN_num_iter_train=5,
    NRN_num_iter_test=5, NRN_ray_relu=True,
)  # fmt: skip
"""Settings of its published weights (experiments exp001_cvpr2024 and exp002_kappa)."""


def _built(checkout: Path, estimates_uncertainty: bool) -> Any:
    if not (checkout / "models" / "dsine" / "v02.py").is_file():
        _without_pretrained_encoder(import_module("models.submodules"))
        return import_module("models.dsine").DSINE()
    name = "v02_kappa" if estimates_uncertainty else "v02"
    program: Any = import_module(f"models.dsine.{name}")
    coordinates = program.get_pixel_coords

    def unmoved(h: int, w: int) -> SimpleNamespace:
        """Coordinates that ignore `to`: DSINE would move them to the first GPU, which may not exist."""
        tensor = coordinates(h=h, w=w)

        def to(device: object) -> Any:
            return tensor

        return SimpleNamespace(to=to)

    program.get_pixel_coords = unmoved
    _without_pretrained_encoder(import_module("models.conv_encoder_decoder.submodules"))
    return getattr(program, f"DSINE_{name}")(_PUBLISHED)


def _without_pretrained_encoder(program: Any) -> None:
    """Keep the encoder from downloading ImageNet weights, which the user's weights replace anyway."""
    create = program.geffnet.create_model

    def without_download(name: str, pretrained: bool = True) -> Any:
        return create(name, pretrained=False)

    program.geffnet = SimpleNamespace(create_model=without_download)
