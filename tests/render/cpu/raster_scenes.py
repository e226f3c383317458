"""Small random scenes for the renderers' tests, and how their pictures are drawn and compared."""

from collections.abc import Callable, Sequence

import numpy as np

from gsrain_engine.render.renderer import Frame, Renderer
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import DrawItem
from gsrain_engine.threads import limited_kernels


def random_gaussians(
    count: int, seed: int = 0, degree: int = 0, depth_m: tuple[float, float] = (1.0, 9.0)
) -> Gaussians:
    """Make Gaussians in front of an eye at the origin that looks along +z."""
    r = np.random.default_rng(seed)
    z = r.uniform(*depth_m, count)
    means = np.stack([r.uniform(-0.6, 0.6, count) * z, r.uniform(-0.5, 0.5, count) * z, z], axis=1)
    scales = np.exp(r.normal(np.log(0.15), 0.8, (count, 3)))
    quaternions = r.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    sh = r.normal(0, 0.5, (count, (degree + 1) ** 2, 3))
    numbers = (means, scales, quaternions, r.uniform(0.02, 1, count), sh)
    return Gaussians(*(np.ascontiguousarray(each, np.float32) for each in numbers))


def small_camera(width: int = 75, height: int = 53) -> Camera:
    """Look along +z with an off-center principal point; the size is no multiple of a tile."""
    return Camera(width, height, 60.0, 64.0, 0.42 * width, 0.55 * height)


def similarity(scale: float, seed: int) -> np.ndarray:
    """A turn by chance, and a scale."""
    rotation, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = scale * rotation * np.sign(np.linalg.det(rotation))
    return matrix


def drawn(renderer: Renderer, parts: Sequence[DrawItem] | Gaussians, *arguments, camera=None, **options) -> Frame:
    """Draw parts, or Gaussians in the world, by the small camera if none is given."""
    parts = [DrawItem(parts, np.eye(4))] if isinstance(parts, Gaussians) else parts
    renderer.draw(parts, camera or small_camera(), *arguments, **options)
    return renderer.read()


def psnr_db(a: Frame, b: Frame) -> float:
    return float(-10 * np.log10(max(np.mean((a.rgba - b.rgba) ** 2), 1e-20)))


def at_each_thread_count(work: Callable[[], bytes]) -> set[bytes]:
    """Results of some work by each number of threads, and once more."""
    results = set[bytes]()
    for threads in (1, 2, 3, 1):
        with limited_kernels(threads):
            results.add(work())
    return results
