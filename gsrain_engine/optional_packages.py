"""Packages that only some features need: what for, and the line that installs them."""

import shlex
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple


class OptionalPackage(NamedTuple):
    """A package of an extra of pyproject.toml."""

    name: str
    """Name on PyPI."""
    extra: str
    purpose: str


OPTIONAL_PACKAGES: Mapping[str, OptionalPackage] = {
    "torch": OptionalPackage(
        "torch", "jobs", "gsrain reconstruct, --photometric-steps and --refine of gsrain recolor, scenes in checkpoints"
    ),
    "diffusers": OptionalPackage("diffusers", "diffusion", "gsrain transfer --method cyclegan-turbo"),
    "transformers": OptionalPackage("transformers", "diffusion", "the text encoder of cyclegan-turbo"),
    "peft": OptionalPackage("peft", "diffusion", "gsrain train-transfer"),
    "safetensors": OptionalPackage("safetensors", "diffusion", "weights in .safetensors files"),
    "onnxruntime": OptionalPackage("onnxruntime", "evaluate", "the detectors of gsrain evaluate detection"),
    "pycocotools": OptionalPackage("pycocotools", "evaluate", "average precision in gsrain evaluate detection"),
    "pyarrow": OptionalPackage(
        "pyarrow", "drive", "gsrain sweep, roll-outs as Parquet, Waymo Perception v2, Argoverse 2"
    ),
    "distributed": OptionalPackage("distributed", "drive", "gsrain sweep on a Dask cluster"),
    "gymnasium": OptionalPackage("gymnasium", "drive", "the environments gsrain/Drive-v0 and gsrain/DrivePlan-v0"),
    "scenariogeneration": OptionalPackage("scenariogeneration", "drive", "writing OpenSCENARIO and OpenDRIVE"),
    "mcap": OptionalPackage("mcap", "recordings", "MCAP files"),
    "rosbags": OptionalPackage("rosbags", "recordings", "bags of ROS 2, and roll-outs for Foxglove"),
    "google.protobuf": OptionalPackage("protobuf", "waymo", "Waymo Perception v1 (TFRecord files)"),
    "rerun": OptionalPackage("rerun-sdk", "rerun", "drives as Rerun recordings"),
    "viser": OptionalPackage("viser", "viser", "gsrain serve --protocol browser, gr.BrowserViewer"),
    "grpc": OptionalPackage("grpcio", "alpasim", "gsrain serve --protocol alpasim"),
    "carla_canvas": OptionalPackage("carla-canvas", "carla", "gsrain serve --protocol carla-canvas"),
    "pxr": OptionalPackage("usd-core", "usd", ".usdz scenes"),
    "xarray": OptionalPackage("xarray", "netcdf", "disdrometer files in NetCDF"),
    "h5netcdf": OptionalPackage("h5netcdf", "netcdf", "disdrometer files in NetCDF 4"),
    "pyrender": OptionalPackage("pyrender", "street", "pictures of gsrain street, with depth, normals and labels"),
    "gsplat": OptionalPackage("gsplat", "cuda", "training on a CUDA GPU"),
}
"""By the module that is imported."""


class MissingPackageError(ImportError, ValueError):
    """A package that a feature needs is not installed; the message says what installs it."""


def has_package(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # the package that it is in is missing
        return False


def require_package(module: str, feature: str, extra: str = "") -> None:
    """Raise `MissingPackageError` if a package of the table is missing.

    Args:
        module: Its module.
        feature: Subject of the message, in the singular: "a .usdz file".
        extra: An extra to install it by, other than that of the table.
    """
    if not has_package(module):
        raise MissingPackageError(missing_package(module, feature, extra), name=module)


def import_package(module: str, feature: str, extra: str = "") -> Any:
    """Import a module of an optional package, or one below it; `require_package` has arguments and error."""
    package = next(each for each in OPTIONAL_PACKAGES if f"{module}.".startswith(f"{each}."))
    require_package(package, feature, extra)
    if package != "torch" or package in sys.modules:
        return import_module(module)
    finder = _TorchFinder()
    sys.meta_path.insert(0, finder)
    try:
        return import_module(module)
    finally:
        sys.meta_path.remove(finder)


class _TorchFinder:
    """Finds torch for a loader that gives the module its name `Tensor` before anything else.

    SciPy asks whether arrays are a `torch.Tensor` as soon as torch is among the modules, in any thread, and fails while
    another one is still importing it, unless the name is there (array-api-compat 1.13).
    """

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name == "torch" else None
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _TorchLoader(spec.loader.name, spec.loader.path)
        return spec


class _TorchLoader(SourceFileLoader):
    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = ModuleType(spec.name)
        module.Tensor = type("Tensor", (), {})  # pyright: ignore[reportAttributeAccessIssue]
        return module


def missing_package(module: str, feature: str, extra: str = "") -> str:
    """Return a sentence without its period: what needs which package, and the line that installs it."""
    package = OPTIONAL_PACKAGES[module]
    return f"{feature} needs {package.name}, which is not installed: {how_to_add(extra or package.extra)}"


_UVX_CACHE = "archive-v0"
"""Folder of uv's cache in which uvx makes environments."""


def how_to_add(name: str, *, is_extra: bool = True) -> str:
    """Return the command that adds an extra, or a package, to the environment of this program (pip, pipx, uv, uvx)."""
    requirement, environment = f"'gsrain[{name}]'" if is_extra else name, Path(sys.prefix)
    if is_frozen():
        return f"install GSRAIN by pip, with {requirement}"
    if (environment / "pipx_metadata.json").is_file():
        return f"pipx runpip {environment.name} install {requirement}"
    if _UVX_CACHE in environment.parts:  # made for one run, without pip
        return f"uvx --from {requirement} gsrain" if is_extra else f"uvx --with {requirement} gsrain"
    python = shlex.quote(sys.executable)
    if (environment / "uv-receipt.toml").is_file():
        return f"uv pip install --python {python} {requirement}"
    return f"{python} -m pip install {requirement}"


def is_frozen() -> bool:
    """Return True in the program built by PyInstaller, which lacks PyAV (its wheel holds encoders under the GPL)."""
    return getattr(sys, "frozen", False)
