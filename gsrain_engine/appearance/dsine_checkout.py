"""DSINE's network, built from a local checkout of its code, on any device and without downloads."""

from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from ..trusted_code import Code, check_named, check_unchanged, importable, read_code

_PACKAGES = ("models", "utils")
"""Packages of the checkout; their names are so common that they must not stay importable."""


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
    if not any((checkout / "models" / file).is_file() for file in ("dsine.py", "dsine/v02.py")):
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
