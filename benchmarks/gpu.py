"""Figures of a machine with an NVIDIA GPU: frames beside gsplat, rain, read-back, training, images, tests.

`make gpu` runs this and writes the figures into docs/gpu.md. Each part runs in a process of its own, the most important
parts first, and each row is written once it is measured: a part that fails or is stopped keeps its rows.
"""

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module, metadata
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import moderngl
import msgspec
import numpy as np
from PIL import Image

from benchmarks.gpu_page import figures, with_figures
from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.editor.viewport.camera import default_path
from gsrain_engine.evaluation.image_metrics import psnr
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.level_of_detail import LodCut, subset_items
from gsrain_engine.render.opengl.context import open_context
from gsrain_engine.render.opengl.renderer import Rasterizer, SplatRenderer
from gsrain_engine.render.opengl.shaders import GpuTimers
from gsrain_engine.render.opengl.sort import check_sort
from gsrain_engine.render.renderer import Renderer, describe_machine
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.view import rain_camera
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.open import (
    is_random_scene,
    load_built_in,
    load_scene,
    random_scene,
    random_scene_camera,
    with_lod_trees,
)
from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.scene.scene import Scene

ROOT = Path(__file__).parent.parent
Row = dict[str, Any]
Size = tuple[int, int]
RAIN_MM_H = 8.5
START_S = 1.0  # the street's vehicle drives from here on


@dataclass(frozen=True, slots=True)
class Workload:
    """Scenes and sizes of all parts."""

    scenes: tuple[str, ...] = ("random-200k", "random-1m", "random-3m")
    sizes: tuple[Size, ...] = ((960, 640), (1920, 1080))
    rainy_scene: str = "street"
    read_size: Size = (1920, 1080)
    compared_scenes: tuple[str, ...] = ("street", "random-200k", "random-1m")
    large_scene: str = "street:long"
    ordinary_scene: str = "random-1m"
    """Scene that a cut of the large one is compared with."""
    sorted_splats: tuple[int, ...] = (1_000_000, 3_000_000)
    trained_gaussians: int = 128_000
    training_size: Size = (640, 427)
    training_views: int = 12
    warm_up_s: float = 0.5
    """Time of untimed frames before the timed ones: a GPU's clock rests while the processor works."""
    timed: int = 30
    limit_s: float = 3.0
    """Slow frames are timed fewer times, to end after about twice this time."""


SMALL = Workload(
    scenes=("random-500",), sizes=((48, 32),), rainy_scene="random-500", read_size=(48, 32),
    compared_scenes=("random-500",), large_scene="random-5k", ordinary_scene="random-500", sorted_splats=(1000,),
    trained_gaussians=300, training_size=(64, 43),
    training_views=2, warm_up_s=0.0, timed=2,
)  # fmt: skip
"""To try the program without a GPU; its times mean nothing."""


class Options(NamedTuple):
    """Options of the command that the parts use."""

    work: Workload
    gsplat: str
    """Module with `rasterization`: gsplat, or a stand-in."""
    output: Path


# Timing


def median_ms(once: Callable[[], float], work: Workload) -> float:
    """Median of the times that `once` returns, after untimed calls."""
    _repeat(once, sys.maxsize, 2, work.warm_up_s)
    return median(_repeat(once, work.timed, 3, work.limit_s))


def _repeat(once: Callable[[], float], count: int, minimum: int, limit_s: float) -> list[float]:
    times, end = list[float](), time.monotonic() + limit_s
    while len(times) < count and (len(times) < minimum or time.monotonic() < end):
        times.append(once())
    return times


def wall_ms(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return 1000 * (time.perf_counter() - start)


def cuda_ms(call: Callable[[], object]) -> float:
    """GPU time by CUDA events around all work of a call; wall time without CUDA."""
    torch: Any = import_module("torch")
    if not torch.cuda.is_available():
        return wall_ms(call)
    start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
    start.record()
    call()
    end.record()
    torch.cuda.synchronize()
    return start.elapsed_time(end)


def torch_device() -> str:
    torch: Any = import_module("torch")
    return "cuda" if torch.cuda.is_available() else "cpu"


class TimedBackend(NamedTuple):
    """A renderer, and a function with the arguments of its `draw` that returns the GPU time of the frame in ms."""

    renderer: Renderer
    draw_ms: Callable[..., float]


def timed_opengl(context: moderngl.Context, rasterizer: Rasterizer) -> TimedBackend:
    """OpenGL renderer timed by one timer query around the whole frame."""
    timers = GpuTimers(context)
    renderer = SplatRenderer(context, rasterizer=rasterizer, timers=timers)

    def draw_ms(*arguments: Any) -> float:
        with timers.stage("frame"):
            renderer.draw(*arguments)
        took_ms = timers.collect()["frame"]
        renderer.finish()
        return took_ms

    return TimedBackend(renderer, draw_ms)


@contextmanager
def timed_backends(options: Options, errors: dict[str, str]) -> Generator[dict[str, TimedBackend]]:
    """Back ends that can be opened; `errors` gets the others."""
    opened: dict[str, TimedBackend] = {}
    with ExitStack() as stack:
        with noted(errors, "opengl"):
            context = open_context()
            stack.callback(context.release)
            stack.enter_context(context)
            for rasterizer in ("tiles", "quads"):
                with noted(errors, f"opengl-{rasterizer}"):
                    opened[f"opengl-{rasterizer}"] = timed_opengl(context, rasterizer)
        yield opened


@contextmanager
def noted(errors: dict[str, str], name: str) -> Generator[None]:
    """Note an error under a name instead of raising it, so that the other measurements run."""
    try:
        yield
    except Exception as error:
        traceback.print_exc()
        errors[name] = f"{type(error).__name__}: {error}"


# Scenes


def timed_scene(name: str) -> Scene:
    return random_scene(name) if is_random_scene(name) else load_scene(name)


def sequence_of(scene: Scene, size: Size, intensity_mm_h: float) -> FrameSequence:
    """Frames of a scene from its default path, in rain of the preset paper."""
    view = (random_scene_camera if is_random_scene(scene.name) else default_path)(scene, *size)
    values = msgspec.to_builtins(load_preset("paper")) | {"intensity_mm_h": intensity_mm_h}
    rainfall = RainSimulation.start(msgspec.convert(values, RainSettings))
    return FrameSequence(scene, rainfall, view, *size, start_s=START_S)


# Parts: each yields rows


def machine(options: Options) -> Iterator[Row]:
    """Processor, card, driver, versions, commit."""
    found: Row = dict(describe_machine())
    commands = {
        "driver": "nvidia-smi --query-gpu=driver_version --format=csv,noheader",
        "commit": "git describe --always --dirty",
    }
    for name, command in commands.items():
        with suppress(OSError, subprocess.CalledProcessError):
            found[name] = subprocess.run(
                command.split(), cwd=ROOT, capture_output=True, text=True, check=True
            ).stdout.strip()
    with noted(found, "gpu"):
        torch: Any = import_module("torch")
        found |= {"torch": torch.__version__, "cuda": torch.version.cuda}
        found["gpu"] = torch.cuda.get_device_name() if torch.cuda.is_available() else "none"
    with noted(found, "opengl"), open_context() as context:
        found["opengl"] = " ".join(context.info[name] for name in ("GL_RENDERER", "GL_VERSION"))
    found["gsplat"] = options.gsplat
    with suppress(metadata.PackageNotFoundError):
        found["gsplat"] = metadata.version(options.gsplat)
    found["date"] = time.strftime("%Y-%m-%d")
    yield found


def build(options: Options) -> Iterator[Row]:
    """Compile gsplat's kernels and ours at the same time, each by a first image; both have caches on the disk."""
    scene = random_scene("random-500")

    def by_gsplat() -> None:
        gsplat_frame(options, scene, random_scene_camera(scene, 48, 32))()
        if torch_device() == "cuda":
            import_module("torch").cuda.synchronize()

    def by_processor() -> None:
        sequence, processor = sequence_of(scene, (48, 32), RAIN_MM_H), CpuRenderer()
        sequence.frame(processor, 0, sequence.sky(processor), with_depth=True)

    with ThreadPoolExecutor() as pool:
        took = {name: pool.submit(wall_ms, call) for name, call in (("gsplat", by_gsplat), ("cpu", by_processor))}
    for name, future in took.items():
        errors = dict[str, str]()
        row: Row = {"kernels": name, "errors": errors}
        with noted(errors, name):
            row["seconds"] = future.result() / 1000
        yield row


def sort(options: Options) -> Iterator[Row]:
    """Check the order of the depth sort."""
    with open_context() as context:
        for count in options.work.sorted_splats:
            check = check_sort(context, count)
            yield {"splats": count, "is_right": check.is_right, "check": str(check)}


def frames(options: Options) -> Iterator[Row]:
    """Whole frames of random scenes by all back ends and by gsplat's own function; stages of tiles."""
    work, missing = options.work, dict[str, str]()
    with timed_backends(options, missing) as backends:
        for name in work.scenes:
            scene = random_scene(name)
            for size in work.sizes:
                camera, errors = random_scene_camera(scene, *size), dict(missing)
                row: Row = {"scene": name, "size": size, "ms": {}, "errors": errors}
                for backend, timed in backends.items():
                    with noted(errors, backend):
                        call = partial(timed.draw_ms, scene.parts(0.0), camera)
                        row["ms"][backend] = median_ms(call, work)
                        row["splats"] = timed.renderer.statistics.splats_drawn
                with noted(errors, "gsplat"):
                    call = partial(cuda_ms, gsplat_frame(options, scene, camera))
                    row["ms"]["gsplat"] = median_ms(call, work)
                if "opengl-tiles" in row["ms"]:
                    with noted(errors, "stages of tiles"):
                        row["stages_ms"] = stages_ms(backends["opengl-tiles"].renderer, scene, camera, work)
                yield row


def stages_ms(renderer: Any, scene: Scene, camera: Camera, work: Workload) -> dict[str, float]:
    """Median GPU time of each stage of an OpenGL frame."""
    found: dict[str, list[float]] = {}
    for _ in range(work.timed):
        renderer.draw(scene.parts(0.0), camera)
        renderer.finish()
        for stage, took_ms in renderer.statistics.stages_ms.items():
            found.setdefault(stage, []).append(took_ms)
    return {stage: median(times) for stage, times in found.items()}


def gsplat_frame(options: Options, scene: Scene, camera: Camera) -> Callable[[], object]:
    """Draw a random scene by gsplat's own function, unpacked, which is its faster way for one camera."""
    from gsrain_engine.render.gsplat_input import view_arguments

    torch: Any = import_module("torch")
    rasterization, device = import_module(options.gsplat).rasterization, torch_device()
    (part,) = scene.parts(0.0)
    gaussians = part.gaussians

    def uploaded(array: np.ndarray) -> Any:
        return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32, device=device)

    names = {"quats": "quaternions", "colors": "sh"}
    arguments: dict[str, Any] = {
        each: uploaded(getattr(gaussians, names.get(each, each)))
        for each in ("means", "quats", "scales", "opacities", "colors")
    }
    arguments["viewmats"] = uploaded(camera.world_to_camera @ part.to_world)[None]
    arguments |= view_arguments(camera, device) | {"sh_degree": gaussians.sh_degree, "packed": False}

    @torch.no_grad()
    def draw() -> object:
        return rasterization(**arguments)

    return draw


def rain(options: Options) -> Iterator[Row]:
    """Frames clear and in rain, which alternate; creating rain on the processor is timed separately."""
    work, missing = options.work, dict[str, str]()
    scene = timed_scene(work.rainy_scene)
    with timed_backends(options, missing) as backends:
        for size in work.sizes:
            for backend in backends | dict.fromkeys(missing):
                errors = {name: text for name, text in missing.items() if name == backend}
                row: Row = {"scene": scene.name, "size": size, "backend": backend, "errors": errors}
                if backend in backends:
                    with noted(errors, backend):
                        row |= _rainy_and_clear_ms(backends[backend], scene, size, work)
                yield row


def _rainy_and_clear_ms(timed: TimedBackend, scene: Scene, size: Size, work: Workload) -> dict[str, float]:
    sequences = {"clear": sequence_of(scene, size, 0.0), "rainy": sequence_of(scene, size, RAIN_MM_H)}
    sky = sequences["rainy"].sky(timed.renderer).light
    times: dict[str, list[float]] = {"clear": [], "rainy": [], "creating": []}
    start_s, number = time.monotonic(), -1  # below 0 while it warms up
    while number < work.timed:
        for name, sequence in sequences.items():
            shot = sequence.shot(max(number, 0))
            parts = scene.parts(shot.time_s, wetness=sequence.rainfall.wetness_at(shot.time_s))
            start = time.perf_counter()
            falling = sequence.rainfall.frame(shot.time_s, rain_camera(scene, sequence.rainfall, shot), sky)
            assert falling.max_drops >= 0 and len(falling.drawn_haze) >= 0  # created at their first use
            created_ms = 1000 * (time.perf_counter() - start)
            took_ms = timed.draw_ms(parts, shot.camera, falling)
            if number >= 0:
                times[name].append(took_ms)
                times["creating"] += [created_ms] if name == "rainy" else []
        passed_s = time.monotonic() - start_s
        if number >= 0 or passed_s > work.warm_up_s:
            number += 1
        if number >= 3 and passed_s > work.limit_s:
            break
    return {f"{name}_ms": median(each) for name, each in times.items()}


def read_back(options: Options) -> Iterator[Row]:
    """Time from a drawn image on the GPU to its 8 bits in memory, by each way that the program has."""
    work = options.work
    scene = random_scene(work.scenes[0])
    camera = random_scene_camera(scene, *work.read_size)
    with open_context() as context:
        renderer = SplatRenderer(context)
        renderer.draw(scene.parts(0.0), camera)
        renderer.read()
        ways: dict[str, Callable[[], object]] = {
            "floats, rounded on the processor": lambda: renderer.read().to_uint8(),
            "bytes, rounded on the GPU": renderer.read_uint8,
        }
        for name, read in ways.items():
            yield {"way": name, "size": work.read_size, "ms": median_ms(partial(wall_ms, read), work)}

        def while_drawing_ms() -> float:
            """Wall time that is left for an image after the next one was drawn, as in videos and drives."""
            renderer.draw(scene.parts(0.0), camera)
            pending = renderer.request_uint8()
            renderer.draw(scene.parts(0.0), camera)
            renderer.finish()
            return wall_ms(pending)

        way = "bytes, copied by the GPU before it draws the next image"
        yield {"way": way, "size": work.read_size, "ms": median_ms(while_drawing_ms, work)}


def images(options: Options) -> Iterator[Row]:
    """PSNR of each back end's image against that of `cpu`; the images are written as PNG."""
    work, missing = options.work, dict[str, str]()
    folder = options.output / "images"
    folder.mkdir(parents=True, exist_ok=True)
    processor = CpuRenderer()
    with timed_backends(options, missing) as backends:
        for name in work.compared_scenes:
            scene = timed_scene(name)
            for intensity in (0.0, RAIN_MM_H):
                errors = dict(missing)
                row: Row = {"scene": name, "mm/h": intensity, "size": work.sizes[0], "psnr_db": {}, "errors": errors}
                sequence = sequence_of(scene, work.sizes[0], intensity)
                sky = sequence.sky(processor)
                truth = np.clip(sequence.frame(processor, 0, sky).over(), 0, 1)
                for backend, renderer in {"cpu": processor, **{key: each[0] for key, each in backends.items()}}.items():
                    with noted(errors, backend):
                        frame = sequence.frame(renderer, 0, sky)
                        Image.fromarray(frame.to_uint8()).save(folder / f"{name}_{intensity:g}_{backend}.png")
                        row["psnr_db"][backend] = psnr(np.clip(frame.over(), 0, 1), truth)
                yield row


def lod(options: Options) -> Iterator[Row]:
    """Frames of a large scene by its level-of-detail cut, of all its Gaussians, and of an ordinary scene."""
    work, size = options.work, options.work.sizes[0]
    large, ordinary = with_lod_trees(timed_scene(work.large_scene)), timed_scene(work.ordinary_scene)
    camera = sequence_of(large, size, 0.0).shot(0).camera
    errors = dict[str, str]()
    row: Row = {"scene": large.name, "size": size, "gaussians": large.gaussian_count, "ms": {}, "errors": errors}
    with noted(errors, "opengl-tiles"), open_context() as context:
        timed = timed_opengl(context, "tiles")
        parts = large.parts(START_S)
        cut = partial(subset_items, parts, LodCut(), camera)
        row["drawn"] = sum(each.drawn_count for each in cut())
        row["finding_ms"] = median_ms(partial(wall_ms, cut), work)
        row["ms"]["cut"] = median_ms(partial(timed.draw_ms, cut(), camera), work)
        row["ms"]["all"] = median_ms(partial(timed.draw_ms, parts, camera), work)
        view = sequence_of(ordinary, size, 0.0).shot(0).camera
        row["ms"]["ordinary"] = median_ms(partial(timed.draw_ms, ordinary.parts(0.0), view), work)
        row["ordinary"] = ordinary.name
    yield row


# Training


def training(options: Options) -> Iterator[Row]:
    """Steps of `gsrain reconstruct` on the street in its middle, and of a plain loop around gsplat of the same size."""
    work, errors = options.work, dict[str, str]()
    row: Row = {"size": work.training_size, "errors": errors}
    with noted(errors, "plain loop"):
        row["plain_ms"] = median_ms(partial(cuda_ms, plain_step(options)), work)
    with noted(errors, "gsrain reconstruct"):
        from gsrain_engine.training.settings import load_settings
        from gsrain_engine.training.train import start_training

        initial_share = 0.7  # of the allowed number of Gaussians
        settings = load_settings(
            None, gaussians=round(work.trained_gaussians / initial_share), width_px=work.training_size[0]
        )
        training = run_to_end(start_training(street_capture(work), settings, [])).training
        steps = iter(range(settings.steps // 2, settings.steps))  # images in full size, all harmonics
        row["gsrain_ms"] = median_ms(partial(cuda_ms, lambda: training.step(next(steps))), work)
        row["gaussians"] = training.model.count
    yield row


def street_capture(work: Workload) -> Capture:
    """Views of the street's Gaussians along its drive, with depth."""
    sequence, processor = sequence_of(load_built_in(), work.training_size, 0.0), CpuRenderer()
    views: list[CaptureFrame] = []
    for number in range(0, 15 * work.training_views, 15):
        shot, frame = sequence.shot(number), sequence.frame(processor, number, None, with_depth=True)
        assert frame.depth is not None
        view = CaptureFrame(
            name=f"{number:04d}", camera=shot.camera, image_source=frame.to_uint8(), time_s=shot.time_s,
            depth_source=frame.depth, sky_source=frame.depth == 0,
        )  # fmt: skip
        views.append(view)
    return Capture("street", tuple(views))


def plain_step(options: Options) -> Callable[[], None]:
    """Forward, L1 + 0.2 D-SSIM, backward, fused Adam, as in gsplat's examples: random Gaussians of SH degree 1."""
    from gsrain_engine.render.gsplat_input import view_arguments

    torch, functional = import_module("torch"), import_module("torch.nn.functional")
    rasterization, device = import_module(options.gsplat).rasterization, torch_device()
    count, (width, height) = options.work.trained_gaussians, options.work.training_size
    generator = torch.Generator(device).manual_seed(0)

    def random(*shape: int) -> Any:
        return torch.randn(*shape, generator=generator, device=device)

    block, corner = (torch.tensor(each, device=device) for each in ([40.0, 12.0, 80.0], [-20.0, -6.0, 3.0]))
    means = torch.rand(count, 3, generator=generator, device=device) * block + corner
    leaves = [means, random(count, 4), random(count, 3) * 0.5 - 2, random(count), random(count, 4, 3) * 0.3]
    for each in leaves:
        each.requires_grad_()
    optimizer = torch.optim.Adam([{"params": [each], "lr": 1e-3} for each in leaves], eps=1e-15, fused=True)
    camera = Camera(width, height, 1.07 * width, 1.07 * width, width / 2, height / 2)
    arguments = view_arguments(camera, device) | {"sh_degree": 1, "packed": False, "render_mode": "RGB+D"}
    views, truth = torch.eye(4, device=device)[None], torch.rand(height, width, 3, device=device)
    bell = torch.exp(-((torch.arange(11.0, device=device) - 5) ** 2) / 4.5)
    bell /= bell.sum()
    window = (bell[:, None] * bell)[None, None].expand(3, 1, 11, 11).contiguous()

    def smooth(image: Any) -> Any:
        return functional.conv2d(image, window, padding=5, groups=3)

    def ssim(one: Any, other: Any) -> Any:
        one, other = (each.permute(2, 0, 1)[None] for each in (one, other))
        a, b = smooth(one), smooth(other)
        aa, bb, ab = smooth(one * one) - a * a, smooth(other * other) - b * b, smooth(one * other) - a * b
        return ((2 * a * b + 1e-4) * (2 * ab + 9e-4) / ((a * a + b * b + 1e-4) * (aa + bb + 9e-4))).mean()

    def step() -> None:
        means, rotations, logs, logits, harmonics = leaves
        rotations, opacities = functional.normalize(rotations, dim=-1), torch.sigmoid(logits)
        image = rasterization(means, rotations, torch.exp(logs), opacities, harmonics, views, **arguments)
        color = image[0][0, ..., :3]
        (0.8 * (color - truth).abs().mean() + 0.2 * (1 - ssim(color, truth))).backward()
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)

    return step


# Tests

GPU_TESTS = ("test_depth_sort.py", "test_differentiable.py")
OPENGL_TESTS = ("test_backends_agree.py", "test_splat_renderer.py", "test_interpreted_gpu.py", "test_drop_pass.py")


def gpu_tests(options: Options) -> Iterator[Row]:
    """Run the tests that are skipped without a GPU."""
    yield _tested("-m", "gpu", *GPU_TESTS)


def opengl_tests(options: Options) -> Iterator[Row]:
    """Run tests of OpenGL, which run on software OpenGL elsewhere."""
    for file in OPENGL_TESTS:
        yield _tested("-m", "not gpu", file)


def _tested(*arguments: str) -> Row:
    plain = ["-p", "no:benchmark", "-p", "no:cacheprovider", "-W", "ignore:Unknown config option"]
    files = [f"tests/render/{each}" if each.endswith(".py") else each for each in arguments]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *plain, *files], cwd=ROOT, capture_output=True, text=True, check=False
    )
    lines = (done.stdout.strip() or done.stderr.strip()).splitlines() or ["no output"]
    failed = [line for line in lines if re.match(r"(FAILED|ERROR)\b", line)]
    names = " ".join(each.rpartition("/")[2] for each in files if each.endswith(".py"))
    return {"tests": names, "summary": lines[-1].strip("= "), "failed": failed}


# Processes

PARTS: dict[str, tuple[Callable[[Options], Iterator[Row]], float]] = {
    "machine": (machine, 60), "build": (build, 180), "sort": (sort, 60), "frames": (frames, 200), "rain": (rain, 90),
    "training": (training, 100), "read_back": (read_back, 60), "images": (images, 90), "lod": (lod, 120),
    "gpu_tests": (gpu_tests, 120), "opengl_tests": (opengl_tests, 120),
}  # fmt: skip
"""Parts in the order of their importance, each with its longest time in seconds."""


def run_part(name: str, arguments: Sequence[str], output: Path, limit_s: float) -> tuple[list[Row], str]:
    """Run a part in a process of its own; returns its rows and its error, or an empty text."""
    rows, log = output / f"{name}.jsonl", output / f"{name}.log"
    rows.write_text("")
    command = [sys.executable, "-m", "benchmarks.gpu", "--part", name, *arguments]
    with log.open("w") as file:
        process = subprocess.Popen(command, cwd=ROOT, stdout=file, stderr=file, start_new_session=True)
        try:
            code, error = process.wait(limit_s), ""
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # its tests are processes, too
            code, error = process.wait(), f"stopped after {limit_s:.0f} s"
    lines = log.read_text(errors="replace").strip().splitlines()
    if code and not error:
        error = lines[-1] if lines else f"ended with {code}"
    return [json.loads(line) for line in rows.read_text().splitlines()], error


def write_rows(options: Options, name: str) -> None:
    """Write the rows of a part, each once it is measured."""
    with (options.output / f"{name}.jsonl").open("w") as file:
        for row in PARTS[name][0](options):
            file.write(json.dumps(row) + "\n")
            file.flush()


def set_build_environment() -> None:
    """Compile gsplat for this GPU only, on all cores: without these settings it takes many minutes."""
    os.environ.setdefault("MAX_JOBS", str(os.cpu_count() or 1))
    with suppress(OSError, subprocess.CalledProcessError):
        query = ["nvidia-smi", "--query-gpu=compute_cap", "--format=csv,noheader"]
        found = subprocess.run(query, capture_output=True, text=True, check=True).stdout.split()
        os.environ.setdefault("TORCH_CUDA_ARCH_LIST", found[0])


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure all parts and write the page after each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "gpu", help="folder of rows, logs and images")
    parser.add_argument("--page", type=Path, help="page that gets the figures; gpu.md in the folder if not set")
    parser.add_argument("--parts", default=",".join(PARTS), help="with commas between")
    parser.add_argument("--seconds", type=float, default=520, help="parts that have not begun by then are left out")
    parser.add_argument("--small", action="store_true", help="tiny scenes, to try the program")
    parser.add_argument("--gsplat", default="gsplat", help="module that has `rasterization`")
    parser.add_argument("--part", choices=PARTS, help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if unknown := set(chosen.parts.split(",")) - set(PARTS):
        parser.error(f"--parts {', '.join(sorted(unknown))}: expected {', '.join(PARTS)}")
    output = chosen.output.absolute()
    options = Options(SMALL if chosen.small else Workload(), chosen.gsplat, output)
    if chosen.part:
        write_rows(options, chosen.part)
        return
    output.mkdir(parents=True, exist_ok=True)
    set_build_environment()
    passed_on = ["--output", str(output), "--gsplat", chosen.gsplat, *(["--small"] if chosen.small else [])]
    page, end = chosen.page or output / "gpu.md", time.monotonic() + chosen.seconds
    results: dict[str, tuple[list[Row], str]] = {}
    text = ""
    for name in chosen.parts.split(","):
        start = time.monotonic()
        left_s = end - start
        if left_s > 0:
            results[name] = run_part(name, passed_on, output, min(PARTS[name][1], left_s))
        else:
            results[name] = [], "left out: no time remained"
        text = figures(results)
        (output / "figures.json").write_text(json.dumps({key: rows for key, (rows, _) in results.items()}, indent=1))
        page.write_text(with_figures(page.read_text() if page.exists() else "", text))
        print(f"{name}: {time.monotonic() - start:.0f} s {results[name][1]}", flush=True)
    print(text)


if __name__ == "__main__":
    main()
