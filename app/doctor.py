"""`gsrain doctor`: available features of this machine, missing ones, and how to install them."""

import importlib.util
import shlex
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import wraps
from importlib import import_module, metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from gsrain_engine import plugins
from gsrain_engine.compile_cache import has_kernels, shipped_processor
from gsrain_engine.optional_packages import (
    OPTIONAL_PACKAGES,
    MissingPackageError,
    how_to_add,
    is_frozen,
    require_package,
)
from gsrain_engine.plugins import Extension, find_extensions
from gsrain_engine.safe_io.text_files import printable_line
from gsrain_engine.threads import kernel_threads

from .console import print, run_with_progress
from .options import JsonFile, flag, option, window_problem
from .outputs import check_writable, write_numbers
from .schema import settings_type

if TYPE_CHECKING:
    from packaging.requirements import Requirement

_FEW_SPLATS, _MANY_SPLATS = (100_000,), (1_000_000, 3_000_000)
"""Numbers of splats for the depth sort test, on software OpenGL and on a GPU."""


class Finding(NamedTuple):
    """Result of one check."""

    name: str
    found: bool
    what: str
    """Description of what was found, or how to get it."""


def doctor(
    *,
    self_test: Annotated[bool, flag("Also run published weights on their authors' input, and compare.")] = False,
    pair: Annotated[
        tuple[Path, Path] | None, option("Authors' input and output of clear2rainy; default: in GSRAIN_TEST_DATA.")
    ] = None,
    json: JsonFile = None,
) -> int:
    """List what GSRAIN can use on this machine. Exit code 1 if something required is missing or wrong."""
    check_writable(json)
    if pair is not None and not self_test:
        raise ValueError("--pair is for --self-test")
    video, kernels = _video(), _kernels()
    opengl, fastest = find_opengl(), _fastest()
    needed = [fastest, kernels] if is_frozen() else [fastest, video, kernels, find_requirements()]
    needed = [*needed, find_opencv()]
    needed = [opengl, *needed] if sys.platform == "linux" else needed  # elsewhere the processor draws without it
    tested = find_depth_order()
    weights = (
        find_lpips, find_inception, find_base_model, find_text_encoder, find_transfer_weights, find_clip_model,
        find_normals_weights, find_normals_program, find_detector_file,
    )  # fmt: skip
    optional = [each() for each in (_osmesa, _display, _cuda, find_gsplat, *weights, find_zsh)]
    optional = [*([video] if is_frozen() else []), *optional, *map(find_package, OPTIONAL_PACKAGES)]
    optional = optional if sys.platform == "linux" else [opengl, *optional]
    lacking, added = _extensions()
    marks = {"MISSING": needed, "WRONG  ": tested, "absent ": [*optional, *lacking], "broken ": added}
    for missing, findings in marks.items():
        for each in findings:
            print(f"{'ok     ' if each.found else missing} {each.name}: {each.what}")
    every = [each for findings in marks.values() for each in findings]
    numbers: dict[str, Any] = {each.name: {"found": each.found, "what": each.what} for each in every}
    is_right = all(each.found for each in (*needed, *tested))
    if self_test:
        from gsrain_engine.appearance.self_test import self_tests  # loads OpenCV, which the list doesn't need

        results = self_tests(pair)
        for each in results:
            print(f"{_MARKS[each.passed]} {each.model}: {each.what}")
        numbers["self_test"] = [
            {"model": each.model, "psnr_db": each.psnr_db, "passed": each.passed} for each in results
        ]
        is_right = is_right and all(each.passed is not False for each in results)
    write_numbers(json, numbers)
    return 0 if is_right else 1


_MARKS = {True: "passed ", False: "DIFFERS", None: "untried"}


def _tried(name: str, attempt: Callable[[], str], remedy: str = "") -> Finding:
    try:
        return Finding(name, True, attempt())
    except Exception as error:  # a missing library may raise anything: its message is the finding
        return Finding(name, False, f"{printable_line(error)} {remedy}".strip())


def finding(name: str, remedy: str = "") -> Callable[[Callable[[], str]], Callable[[], Finding]]:
    """Make a check of a function that returns what it has found, or raises why it is missing."""

    def decorated(attempt: Callable[[], str]) -> Callable[[], Finding]:
        return wraps(attempt)(lambda: _tried(name, attempt, remedy))

    return decorated


@finding("OpenGL without a window (EGL)")
def find_opengl() -> str:
    from gsrain_engine.render.opengl.context import nvidia_remedy

    found = _describe_context("egl")
    return f"{found}; {remedy}" if "(software)" in found and (remedy := nvidia_remedy()) else found


@finding("OSMesa (stands in where EGL is missing)", "(optional; Debian 13 no longer has it)")
def _osmesa() -> str:
    return _describe_context("osmesa")


def _describe_context(source: Literal["egl", "osmesa"]) -> str:
    from gsrain_engine.render.opengl.context import WINDOW_VERSION, is_software, open_context

    context = open_context(source, WINDOW_VERSION)
    with context:
        kind = "software" if is_software(context) else "GPU"
        return f"{context.info['GL_RENDERER']}, {_version(context.version_code, f' ({kind})')}"


def _version(code: int, kind: str = "") -> str:
    """Name a version of OpenGL, and say what follows from an old one."""
    from gsrain_engine.render.opengl.context import RENDERER_VERSION, version_name

    return f"{version_name(code)}{kind}{'' if code >= RENDERER_VERSION else ': the processor draws'}"


@finding("fastest back end (--backend auto)")
def _fastest() -> str:
    from gsrain_engine.backends import DeviceSpeed, measure_device
    from gsrain_engine.render.opengl.context import WINDOW_VERSION, NoOpenGLError, open_context

    try:
        context = open_context(lowest=WINDOW_VERSION)
    except NoOpenGLError:
        return "cpu: there is no OpenGL"
    try:
        with context:
            speed: DeviceSpeed = measure_device(context)
        return f"{'cpu' if speed.is_cpu_fastest else f'opengl-{speed.rasterizer}'}: {speed.reason}"
    finally:
        context.release()


def find_depth_order() -> list[Finding]:
    """Test the depth sort of splats that `--backend opengl` runs on a GPU; empty without OpenGL.

    A wrong order gives wrong images, and may be a driver bug. Software rasterizers, which run threads one after
    another, sort fewer splats.
    """
    from gsrain_engine.render.opengl.context import NoOpenGLError, is_software, open_context
    from gsrain_engine.render.opengl.sort import check_sort

    def order() -> str:
        with context:
            counts = _FEW_SPLATS if is_software(context) else _MANY_SPLATS
            checks = [check_sort(context, count) for count in counts]
        if wrong := [str(check) for check in checks if not check.is_right]:
            raise RuntimeError(f"{'; '.join(wrong)}.")
        return f"right for {' and '.join(f'{count:,}' for count in counts)} splats, twice the same"

    try:
        context = open_context()
    except NoOpenGLError:
        return []
    try:
        return [_tried("order of splats by depth (OpenGL)", order, "Pictures may be wrong: draw with --backend cpu")]
    finally:
        context.release()


def _video() -> Finding:
    def encoders() -> str:
        import av

        names = [name for name in ("libx264", "libvpx-vp9") if name in av.codecs_available]
        return f"PyAV {av.__version__} with {', '.join(names)}"

    return _tried("video", encoders, "(left out of frozen programs)" if is_frozen() else "pip install av")


@finding("compiled kernels", "pip install numba")
def _kernels() -> str:
    import numba

    assert numba.njit(lambda: 1)() == 1
    if shipped_processor() is not None:
        found = "brought by the installation"
    else:
        found = "all compiled" if has_kernels() else "to be compiled at first use"
    return f"Numba {numba.__version__}, {kernel_threads()} threads; {found}"


@finding("versions of packages")
def find_requirements() -> str:
    """Compare what is installed with what this program needs: another package may have brought an older version."""
    if unmet := unmet_requirements([""]):
        raise RuntimeError("; ".join(unmet.values()))
    return "as needed"


def unmet_requirements(extras: Sequence[str]) -> dict[str, str]:
    """Return a sentence for each package of extras ("": without any) that is installed in another version than needed.

    It names the packages that limit the version, such as nuscenes-devkit (NumPy below 2).
    """
    found: dict[str, str] = {}
    for each in _required("gsrain", metadata.requires("gsrain"), extras):
        with suppress(metadata.PackageNotFoundError):  # its import says more
            version = metadata.version(each.name)
            if not each.specifier.contains(version, prereleases=True):
                limits = " and ".join(_limits(each.name))
                found[each.name] = (
                    f"{each.name} {version} is installed{limits and f' for {limits}'}, but GSRAIN needs "
                    f"{each.specifier}: install one of them in an environment of its own, or "
                    f"{shlex.quote(sys.executable)} -m pip install '{each.name}{each.specifier}'"
                )
    return found


def _required(package: str, lines: list[str] | None, extras: Sequence[str]) -> "Iterator[Requirement]":
    from packaging.requirements import Requirement

    for each in map(Requirement, lines or ()):
        if each.name != package and (not each.marker or any(each.marker.evaluate({"extra": name}) for name in extras)):
            yield each


def _limits(name: str) -> Iterator[str]:
    """Yield the installed packages, and their requirement, that do not take each newer version of a package."""
    for package in metadata.distributions():
        own = package.metadata["Name"]
        for each in _required(own, package.requires, [""]):
            if each.name.lower() == name.lower() and {"<", "<=", "==", "~="} & {one.operator for one in each.specifier}:
                yield f"{own} ({each.name}{each.specifier})"


@finding("OpenCV", "Reinstall it: pip install --force-reinstall opencv-python-headless")
def find_opencv() -> str:
    """Load OpenCV, and name the packages that install it: they write the same files, so that the last one counts."""
    import cv2

    packages = [] if is_frozen() else sorted(set(metadata.packages_distributions().get("cv2", ())))
    several = "; they share their files, and any of them will do: after uninstalling one, reinstall another"
    return f"{cv2.__version__}, of {', '.join(packages) or 'this program'}{several if len(packages) > 1 else ''}"


def _display() -> Finding:
    problem = window_problem()
    if problem:
        return Finding("display", False, f"{problem}: rendering to files and gsrain serve work, the window does not")

    def version() -> str:
        from ui.window import window_version  # loads the GUI libraries only with a display

        return f"the window can open, by {_version(window_version())}"

    return _tried("display", version, "(rendering to files and gsrain serve work, the window does not)")


def find_package(module: str) -> Finding:
    name, extra, purpose = OPTIONAL_PACKAGES[module]
    try:
        if not is_frozen() and (wrong := unmet_requirements([extra]).get(name)):
            return Finding(name, False, wrong)
        return Finding(name, True, f"{metadata.version(name)}, for {purpose}")
    except metadata.PackageNotFoundError:
        return Finding(name, False, f"not installed; for {purpose}: {how_to_add(extra)}")


@finding("CUDA")
def _cuda() -> str:
    if importlib.util.find_spec("torch") is None:
        raise RuntimeError("not looked for: torch is not installed")
    import torch

    if not torch.cuda.is_available():
        raise RuntimeError("torch sees no CUDA device; jobs run on the processor.")
    return torch.cuda.get_device_name()


@finding("gsplat (trains on CUDA GPUs)")
def find_gsplat() -> str:
    """Load gsplat's kernels: it is installed without them and compiles them itself."""
    if importlib.util.find_spec("gsplat") is None:
        raise RuntimeError(f"not installed: {how_to_add('cuda')}")
    import torch

    from gsrain_engine.render.gsplat_build import build_gsplat

    if not torch.cuda.is_available():
        raise RuntimeError("torch sees no CUDA device; gsrain reconstruct trains on the processor.")
    run_with_progress(build_gsplat())
    return f"{metadata.version('gsplat')}, gsrain reconstruct trains on {torch.cuda.get_device_name()}"


@finding("LPIPS weights (a quality measure of reports)")
def find_lpips() -> str:
    """Look for LPIPS weights and read them, since a file may be damaged or hold something else."""
    from gsrain_engine.evaluation.lpips_weights import find_lpips_weights, lpips_place

    try:
        find_lpips_weights("vgg")
        return f"VGG16 at {lpips_place()}"
    except FileNotFoundError as error:
        missing = str(error)
    with suppress(FileNotFoundError):
        find_lpips_weights("alex")
        missing = f"only AlexNet at {lpips_place()}, used where --lpips names its file; {missing}"
    raise FileNotFoundError(missing)


@finding("Inception weights (of FID)")
def find_inception() -> str:
    """Look for Inception's weights, which define FID; they are read if torch is installed."""
    from gsrain_engine.evaluation import fid_torch_features as features

    found = features.inception_weights_file()
    if features.is_torchscript(found):
        return f"{found}, TorchScript: gsrain evaluate fid takes it with --torchscript"
    if importlib.util.find_spec("torch") is not None:
        features.inception_weights(found)
    return str(found)


@finding("detector (camera-idm of gsrain drive)")
def find_detector_file() -> str:
    """Look for the detector of the agent camera-idm; it is opened if onnxruntime is installed."""
    from gsrain_engine.evaluation.detection.detector import find_detector, open_detector

    found = find_detector()
    if importlib.util.find_spec("onnxruntime") is None:
        return str(found)
    wide, high = open_detector(found).input_size_px
    return f"{found} (sees {wide} x {high} px)"


@finding("SD-Turbo (base of cyclegan-turbo)")
def find_base_model() -> str:
    """Look for SD-Turbo, the base of cyclegan-turbo, in diffusers' layout: complete, and of the right architecture."""
    from gsrain_engine.appearance.cyclegan_turbo import weight_paths as paths
    from gsrain_engine.appearance.cyclegan_turbo.model import check_base, sd_turbo

    found = paths.find_base_model()
    check_base(found, sd_turbo())
    paths.check_base_complete(found)
    return str(found)


@finding("text encoder of SD-Turbo")
def find_text_encoder() -> str:
    """Look for the text encoder, needed only once, because its encoded captions are cached."""
    from gsrain_engine.appearance.cyclegan_turbo import weight_paths as paths

    if paths.captions_file().is_file():
        return f"not needed: its captions are kept in {paths.captions_file()}"
    base = next(filter(paths.is_base_model, paths.base_model_folders()), None)
    folder = None if base is None else paths.text_encoder_folder(base)
    if folder is None:
        raise FileNotFoundError("comes with SD-Turbo (text_encoder, tokenizer); needed once, to encode captions")
    return str(folder)


@finding("transfer weights (of cyclegan-turbo)")
def find_transfer_weights() -> str:
    """Look for the weights that turn SD-Turbo into a transfer."""
    from gsrain_engine.appearance.cyclegan_turbo import weight_paths as paths

    found = paths.find_transfer_weights()
    return f"{found} ({found.stat().st_size / 1e6:,.0f} MB)"


@finding("CLIP ViT-B/32 (for gsrain train-transfer)")
def find_clip_model() -> str:
    """Look for the vision model behind the discriminators of transfer training."""
    from gsrain_engine.appearance.finetune.settings import find_clip

    return str(find_clip())


@finding("DSINE weights (normals of pictures without depth)")
def find_normals_weights() -> str:
    """Look for DSINE's weights, which estimate the normals of the paper's fine-tuning."""
    from gsrain_engine.appearance.dsine_checkout import find_dsine_weights

    return str(find_dsine_weights())


@finding("DSINE program (runs DSINE's weights)")
def find_normals_program() -> str:
    """Look for the user's copy of DSINE's program, and for the package that it needs. None of its code runs."""
    from gsrain_engine.appearance.dsine_checkout import find_dsine_checkout, has_geffnet

    found = find_dsine_checkout()
    if not has_geffnet():
        raise FileNotFoundError(f"{found}, which needs geffnet: {how_to_add('geffnet', is_extra=False)}")
    return str(found)


_CLIENT = (
    "name your own copy of the client: gsrain drive --hugsim-dir pipes --hugsim-client "
    "'zsh /path/UniAD_SIM/tools/e2e.sh 0'"
)


@finding("zsh (for HUGSIM's clients UniAD_SIM and VAD_SIM)")
def find_zsh() -> str:
    """Look for the shell of the clients' `tools/e2e.sh`; a client itself may lie anywhere."""
    found = shutil.which("zsh")
    if found is None:
        raise FileNotFoundError(f"not found; on Debian: apt-get install zsh; then {_CLIENT}")
    return f"{found}; {_CLIENT}"


# Extensions of other installed packages


def installed_extensions() -> list[Extension]:
    return [each for group in plugins.GROUPS for each in find_extensions(group)]


def _extensions() -> tuple[list[Finding], list[Finding]]:
    """Return the extensions that lack a package, and the others."""
    lacking: list[Finding] = []
    others: list[Finding] = []
    for each in installed_extensions():
        name = f"{each.group.noun} {each.name}"
        try:
            others.append(Finding(name, True, describe(each)))
        except MissingPackageError as error:
            lacking.append(Finding(name, False, str(error)))
        except Exception as error:  # of others' code
            others.append(Finding(name, False, printable_line(error)))
    return lacking, others


def describe(extension: Extension) -> str:
    """Load an extension as the program would, and return its origin.

    Raises `MissingPackageError` if it lacks a package, ValueError if it is unusable.
    """
    origin = f"{extension.place} of {extension.package} {extension.version}".rstrip()
    loaded: object = None
    if extension.group in _KINDS:
        module, _, kind = _KINDS[extension.group].partition(":")
        loaded = extension.load(getattr(import_module(module), kind))
    elif extension.group is plugins.SCENE_FORMATS:
        from gsrain_engine.scene.formats.registry import format_of

        loaded = format_of(Path(f"scene.{extension.name}"))
    elif extension.group is plugins.TRANSFERS:
        from gsrain_engine.appearance.registry import find_method

        find_method(extension.name)
    elif extension.group is plugins.DECODERS:
        from gsrain_engine.evaluation.detection.decoders import decoder

        decoder(extension.name)
    elif extension.group is plugins.SETTINGS:
        settings_type(extension.name)
    else:  # agents, commands, evaluations and scenario formats
        extension.load_callable()
    for package in getattr(loaded, "packages", ()):
        require_package(package, origin)
    return origin


_KINDS = {
    plugins.PANELS: "ui.panels.registry:Panel",
    plugins.DISDROMETERS: "gsrain_engine.disdrometer.open:LogFormat",
    plugins.CAPTURE_FORMATS: "gsrain_engine.datasets.open_capture:CaptureFormat",
    plugins.DRIVE_EXPORTS: "gsrain_engine.simulation.drive_exports:DriveExport",
    plugins.MODELS: "gsrain_engine.scene.models:ModelLibrary",
    plugins.SCENE_EDITS: "gsrain_engine.editor.scene_edits:SceneEdit",
    plugins.SCENES: "gsrain_engine.scene.built_in:BuiltInScene",
    plugins.PROTOCOLS: "gsrain_engine.simulation.serving.protocols:ServerProtocol",
}
"""Types of extensions that are values."""
