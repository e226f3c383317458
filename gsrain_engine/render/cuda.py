"""CUDA renderer: scene and rain with gsplat on an NVIDIA GPU, for data-center GPUs with hardly any graphics pipeline.

gsplat has the same conventions as the other renderers: 0.3 px^2 of dilation, alpha cut at 1/255 and at most 0.999, end
at a transmittance of 1e-4 (Ye et al. 2025). This renderer has been tested only on torch's CPU with a stand-in for
gsplat based on our own rasterizer (tests/render/cuda/gsplat_stand_in.py), not with gsplat or a GPU.
"""

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32, Int64, UInt8

from ..rain.frame import RainFrame
from ..rain.lamp_light import SLICE_SCALE_M, LampLight, light_in_picture
from ..rain.medium import RainMedium
from ..scene.camera import Camera
from ..scene.gaussians import Gaussians
from ..scene.geometry import quaternions_from_matrices
from ..scene.scene import DrawItem
from ..water.mirror import Mirror
from .cpu.compositing import add_light, sky_layer
from .cpu.projection import DILATION_PX2, NEAR_M, TINT, TINT_SHARE, Splats, eye_in_object, project
from .cpu.tiles import MAX_ALPHA
from .mirror import film_items
from .renderer import MIN_WEIGHT, Color, Frame, PendingImage, RenderMode, RenderStatistics, timed

torch: Any = import_module("torch")
Tensor = Any
"""torch is an optional dependency: this module is imported only if it is installed, and its types can't be named."""


class CudaRenderer:
    """Renders scene and rain into one image.

    Args:
        rasterize: `gsplat.rasterization`, or a function with the same signature.
        device: torch device, such as "cuda".
    """

    name = "cuda"

    def __init__(self, rasterize: Callable[..., tuple[Tensor, Tensor, dict[str, Any]]], device: str) -> None:
        self.statistics = RenderStatistics()
        self._rasterize = rasterize
        self._device = device
        self._arrays = CudaArrays(device)
        self._frame: tuple[Tensor, Tensor | None] | None = None

    @property
    def device_name(self) -> str:
        return torch.cuda.get_device_name() if self._device.startswith("cuda") else self._device

    def draw(
        self,
        parts: Sequence[DrawItem],
        camera: Camera,
        rain: RainFrame | None = None,
        *,
        with_depth: bool = False,
        look: RenderMode = "splats",
        mirror: Mirror | None = None,
    ) -> None:
        """Draw parts and rain as one compositing; `read` returns the image.

        `camera` is in the world (meters). The scene is sorted exactly; rain is inserted in slabs of depth, see
        `composite_rain_slabs`. Depth is the scene's own. Raises `ValueError` for any render mode except "splats".
        """
        if look != "splats":
            raise ValueError(f"the cuda back end shows splats only; look at {look} with --backend opengl or cpu")
        self.statistics = RenderStatistics(stages_ms={"project": 0.0, "draw": 0.0, "rain": 0.0})
        falling = Gaussians.empty()
        if rain is not None:
            falling = Gaussians.concatenate([rain.lit_streaks, rain.drawn_haze])
            self.statistics.drops_drawn, self.statistics.haze_drawn = len(rain.drops.numbers), len(rain.haze)
        reflected: Tensor | None = None
        if mirror is not None:
            with self._timed("draw"):
                space = self._arrays.before_camera(film_items(parts), camera)
                film, _ = self._composited(space, camera, None, is_lit=False)
                reflected = uploaded(mirror.reflected(film[..., :2].cpu().numpy()), self._device)
        with self._timed("project"):
            scene = self._arrays.before_camera(parts, camera)
            medium = rain.medium if rain is not None else None
            if rain is not None and medium is not None:
                scene = scene._replace(colors=_dimmed(scene, medium, is_linear=rain.is_linear))
        slabs: DepthSlabs | None = None
        lit = rain.lamp_light if rain is not None and rain.is_linear else None
        drop_light: Tensor | None = None
        if len(falling):
            with self._timed("rain"):
                drops = DrawItem(falling, np.eye(4))
                slabs = split_into_depth_slabs(project([drops], camera, [np.ones(drops.drawn_count, np.bool_)]))
        with self._timed("draw"):
            image, alpha = self._composited(scene, camera, slabs, is_lit=lit is not None)
            rgba, depth, weight = torch.cat([image[..., :3], alpha], dim=-1), None, alpha[..., 0]
            edges = image[..., 4 if lit is None else 5 :]
            if medium is not None:  # a layer behind the scene
                sky = (1 - alpha) * torch.as_tensor(sky_layer(medium, camera), device=self._device)
                rgba = rgba + sky
                edges = torch.cat([edges[..., :-1], edges[..., -1:] + sky[..., 3:]], dim=-1) if slabs else edges
            if with_depth:
                mean = image[..., 3] / torch.clamp(weight, min=float(MIN_WEIGHT))
                depth = torch.where(weight > float(MIN_WEIGHT), mean, 0.0)
        self.statistics.gaussians = sum(part.drawn_count for part in parts)
        if rain is not None and slabs is not None:
            with self._timed("rain"):
                rgba, drop_light = composite_rain_slabs(rgba, edges, slabs, rain)
            self.statistics.splats_drawn += len(slabs.shapes)
            self.statistics.gaussians += len(falling)
        if lit is not None:
            with self._timed("rain"):
                weights = image[..., 4], weight
                rgba = _lit_by_lamps(rgba, weights if medium is not None else None, drop_light, lit)
        if reflected is not None:
            colors = torch.where(reflected > 0, _to_display(_to_linear(rgba[..., :3]) + reflected), rgba[..., :3])
            rgba = torch.cat([colors, rgba[..., 3:]], dim=-1)
        self._frame = rgba, depth
        self._arrays.release_unused()

    def read(self) -> Frame:
        assert self._frame is not None, "draw before reading the picture"
        rgba, depth = self._frame
        return Frame(rgba.cpu().numpy(), depth.cpu().numpy() if depth is not None else None)

    def read_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> UInt8[np.ndarray, "h w 3"]:
        return self.read().to_uint8(background)

    def request_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> PendingImage:
        return partial(self.read().to_uint8, background)

    def _composited(
        self, scene: "CameraSpace", camera: Camera, slabs: "DepthSlabs | None", *, is_lit: bool
    ) -> tuple[Tensor, Tensor]:
        """Blend color, depth and, for rain, one channel per slab edge: (h, w, 4 + edges) and alpha (h, w, 1).

        With light of lamps the share of depth comes before the edges.
        """
        depths = scene.means[:, 2]
        shares = [(depths / (depths + SLICE_SCALE_M))[:, None]] if is_lit else []
        channels = [
            scene.colors,
            depths[:, None],
            *shares,
            *([slab_edge_channels(depths, slabs)] if slabs is not None else []),
        ]
        colors = torch.cat(channels, dim=1)
        if not len(depths):  # gsplat rejects an empty scene
            blank = torch.zeros((camera.height, camera.width, colors.shape[1] + 1), device=self._device)
            return blank[..., :-1], blank[..., -1:]
        images, alphas, found = self._rasterize(
            means=scene.means, quats=scene.quaternions, scales=scene.scales, opacities=scene.opacities, colors=colors,
            viewmats=torch.eye(4, device=self._device)[None],  # already in the camera's frame
            **view_arguments(camera, self._device),
        )  # fmt: skip
        self.statistics.splats_drawn = int((found["radii"] > 0).all(dim=-1).sum())
        return images[0], alphas[0]

    @contextmanager
    def _timed(self, stage: str) -> Generator[None]:
        """Time a stage; waits for the device at its end, so that stage times don't overlap."""
        with timed(self.statistics.stages_ms, stage):
            yield
            if self._device.startswith("cuda"):
                torch.cuda.synchronize()


def view_arguments(camera: Camera, device: Any) -> dict[str, Any]:
    """Arguments of `gsplat.rasterization` for a camera's image and our conventions."""
    intrinsics = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
    size = {"width": camera.width, "height": camera.height}
    lens = uploaded(np.array(intrinsics, np.float32), device)
    return {"Ks": lens[None], **size, "near_plane": NEAR_M, "eps2d": DILATION_PX2}


def uploaded(values: np.ndarray, device: Any) -> Tensor:
    """Copy an array to a device without waiting for it: on CUDA from pinned memory, which torch frees after the copy.

    For small arrays and single images: the pinned copy stays allocated for the next one.
    """
    tensor = torch.from_numpy(np.ascontiguousarray(values))
    if torch.device(device).type != "cuda":
        return tensor.to(device)
    return tensor.pin_memory().to(device, non_blocking=True)


# Gaussians as tensors
# Uploaded once, and transformed to the camera's frame for each frame.


class CameraSpace(NamedTuple):
    """Gaussians of all parts in the camera's frame (OpenCV axes, meters), in gsplat's layout."""

    means: Tensor  # (n, 3)
    scales: Tensor  # (n, 3)
    quaternions: Tensor  # (n, 4) wxyz, unit
    opacities: Tensor  # (n,)
    colors: Tensor  # (n, 3) display color, never negative


class CudaArrays:
    """Uploads Gaussians on first use and finds them by identity."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._held: dict[int, tuple[object, tuple[Tensor, ...]]] = {}
        self._used: set[int] = set()

    def before_camera(self, parts: Sequence[DrawItem], camera: Camera) -> CameraSpace:
        """Move the drawn Gaussians of each part to the camera's frame; evaluate harmonics in the part's own frame."""
        moved = [self._moved(part, camera) for part in parts]
        nothing = (self._uploaded(np.zeros(shape, np.float32)) for shape in ((0, 3), (0, 3), (0, 4), 0, (0, 3)))
        return CameraSpace(*(torch.cat(each) for each in zip(nothing, *moved, strict=True)))

    def release_unused(self) -> None:
        """Free every set that was not used since the last call."""
        self._held = {key: held for key, held in self._held.items() if key in self._used}
        self._used.clear()

    def _moved(self, part: DrawItem, camera: Camera) -> CameraSpace:
        object_to_camera = camera.world_to_camera @ part.to_world  # float64 for accuracy far from the origin
        scale = float(np.cbrt(np.linalg.det(object_to_camera[:3, :3])))
        w, x, y, z = quaternions_from_matrices(object_to_camera[:3, :3] / scale)
        turn = np.array([[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]])  # q @ turn is their product
        rows, arrays = _rows(part), self._found(part.gaussians, lambda: _finite_arrays(part.gaussians))
        means, scales, quaternions, opacities, sh = (each[rows] for each in arrays)
        linear, shift = self._uploaded(object_to_camera[:3, :3].T), self._uploaded(object_to_camera[:3, 3])
        directions = means - self._uploaded(eye_in_object(camera, part))
        directions = directions / torch.linalg.norm(directions, dim=1, keepdim=True)
        basis = sh_basis(directions)[:, : sh.shape[1]]
        colors = torch.einsum("nk,nkc->nc", basis, sh) + 0.5
        if part.is_wet:
            (wet_sh,) = self._found(part.wet_sh, lambda: (part.wet_sh,))
            soaked = torch.einsum("nk,nkc->nc", basis, wet_sh[rows]) + 0.5
            colors = (1 - part.wetness) * colors + part.wetness * soaked
            opacities = torch.where(torch.isfinite(colors).all(dim=1), opacities, 0)
            colors = torch.nan_to_num(colors)
        if part.colors is not None:
            colors = colors @ self._uploaded(part.colors[:, :3].T) + self._uploaded(part.colors[:, 3])
        colors = torch.clamp(colors, min=0)
        if part.selected is not None:
            tinted = torch.as_tensor(part.selected.flags, device=self._device)[rows][:, None]
            colors = torch.where(tinted, torch.lerp(colors, self._uploaded(np.array(TINT)), TINT_SHARE), colors)
        scales, quaternions = scales * (scale * part.growth), quaternions @ self._uploaded(turn)
        return CameraSpace(means @ linear + shift, scales, quaternions, opacities * part.opacity, colors)

    def _found(self, source: object, arrays: Callable[[], tuple[Any, ...]]) -> tuple[Tensor, ...]:
        key = id(source)
        self._used.add(key)
        if key not in self._held:  # with a reference, so that the identity stays unique
            self._held[key] = source, tuple(map(self._uploaded, arrays()))
        return self._held[key][1]

    def _uploaded(self, values: np.ndarray) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(values, np.float32), device=self._device)


def _dimmed(scene: CameraSpace, medium: RainMedium, *, is_linear: bool) -> Tensor:
    """Colors that arrive through a medium, as `dim_by_medium` computes them."""
    kept, device = medium_transmittance(scene.means, medium)[:, None], scene.means.device
    light = torch.as_tensor(medium.airlight_linear, device=device)
    if is_linear:
        return _to_display(kept * _to_linear(scene.colors) + (1 - kept) * light)
    return kept * scene.colors + (1 - kept) * _to_display(light)


def medium_transmittance(points: Tensor, medium: RainMedium) -> Tensor:
    """Share of light from points in the camera's frame (n, 3), as `RainMedium.transmittance`, on the device."""
    numbers, drawn = (torch.as_tensor(each, device=points.device) for each in (medium.numbers, medium.drawn))
    length = torch.clamp(torch.linalg.norm(points, dim=1), min=1e-9)
    enters, leaves = torch.zeros_like(length), length
    if medium.has_region:
        enters, leaves = _within(points, length, numbers[17:32])
    first, last = _within(points, length, numbers[2:17])
    first, last = torch.maximum(first, enters), torch.minimum(last, leaves)
    slope = torch.clamp(points[:, 2] / length, min=1e-9)

    def drawn_up_to(depth: Tensor) -> Tensor:
        at = torch.clamp(depth / numbers[1], 0, len(drawn) - 1)
        k = torch.clamp(at.long(), max=len(drawn) - 2)
        return torch.lerp(drawn[k], drawn[k + 1], at - k)

    streaks = (drawn_up_to(last * slope) - drawn_up_to(first * slope)) / slope
    depth = numbers[0] * (leaves - enters) - torch.where((last > first) & (points[:, 2] > 0), streaks, 0.0)
    return torch.exp(-torch.clamp(depth, min=0))


def _within(points: Tensor, length: Tensor, box: Tensor) -> tuple[Tensor, Tensor]:
    """Distances at which rays to points enter and leave a box, between 0 and their lengths."""
    along = points @ box[:9].reshape(3, 3).T / length[:, None]
    along = torch.where(along.abs() > 1e-9, along, 1e-9)
    start, half = box[9:12], box[12:15]
    ends = torch.stack([(-half - start) / along, (half - start) / along])
    enters = torch.clamp(ends.amin(dim=0).amax(dim=1), min=0)
    leaves = torch.minimum(ends.amax(dim=0).amin(dim=1), length)
    return enters, torch.maximum(enters, leaves)


def _rows(part: DrawItem) -> Any:
    """Drawn Gaussians of a part: a slice without a mask or members, or else their indices."""
    if part.members is not None:
        return torch.from_numpy(part.members if part.opacity > 0 else part.members[:0])
    count = part.drawn_count if part.opacity > 0 else 0
    if part.left_out is None:
        return slice(0, count)
    indices = (~part.left_out).indices
    return torch.from_numpy(indices[indices < count])


def sh_basis(directions: Tensor) -> Tensor:
    """Real spherical harmonics up to degree 3 (n, 16) in unit directions (n, 3), with 3DGS signs."""
    x, y, z = directions.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    harmonics = [
        torch.full_like(x, 0.28209479177387814),
        -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
        1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy), 2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy), 0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy), 1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    ]  # fmt: skip
    return torch.stack(harmonics, dim=1)


def _finite_arrays(g: Gaussians) -> tuple[np.ndarray, ...]:
    """Make Gaussians that contain NaN or infinity transparent, since gsplat doesn't check them."""
    arrays = g.means, g.scales, g.quaternions, g.opacities, g.sh
    bad = ~np.logical_and.reduce([np.isfinite(each).all(axis=tuple(range(1, each.ndim))) for each in arrays])
    if bad.any():
        arrays = tuple(np.where(bad.reshape(-1, *[1] * (each.ndim - 1)), np.float32(0), each) for each in arrays)
        arrays[2][bad, 0] = 1
    return arrays


# Rain
# gsplat's fixed alpha cutoff of 1/255 would erase it. gsplat renders the scene with its blending weights gathered by
# depth, with one channel per edge between slabs of rain; rain is composited slab by slab in between. Inside a slab rain
# is assumed to be spread evenly over its depth.

SLABS = 91  # 91 slabs have 92 edges; with color and depth that makes 96 channels, of which gsplat draws 32 at once
_COLUMNS = 1 << 14  # pixel columns of splats that are processed at once
_OPAQUE = 0.98  # the other renderers end a pixel that would keep less than 1e-4, with up to 2 % of light left
_FIXED_POINT = 2.0**40  # logarithms are added as integers: the sum, and thus the output, doesn't depend on the order


@dataclass(frozen=True, slots=True, eq=False)
class DepthSlabs:
    """Splats of rain, nearest first, in slabs of equal weight."""

    shapes: Float32[np.ndarray, "m 8"]
    """As in `Splats`."""
    starts: Int64[np.ndarray, " slabs_and_one"]
    """First splat of each slab; the last entry is the number of splats."""
    colors: Float32[np.ndarray, "m 3"]
    """Colors of the splats: with lamps, their light in linear light."""
    edges_m: Float32[np.ndarray, " slabs_and_one"]
    """Depths between the slabs, including those of the nearest and the farthest splat; rising."""


def split_into_depth_slabs(splats: Splats, slabs: int = SLABS) -> DepthSlabs:
    """Split rain at depths that give each slab the same weight: opacity times the area of its ellipse.

    Only the scene's splats inside a slab are drawn in the wrong order relative to rain: a small share of the rain at
    any depth.
    """
    order = splats.nearest_first()
    shapes, depths = splats.shapes[order], splats.colors[order, 3]
    x, y, opacity = (shapes[:, column].astype(np.float64) for column in (3, 4, 5))
    weights = np.cumsum(np.exp(opacity) / np.sqrt(x * y))
    total = weights[-1] if len(order) else 0.0
    inner = np.searchsorted(weights, total * np.arange(1, slabs) / slabs)
    starts = np.concatenate([[0], inner, [len(order)]]).astype(np.int64)
    edges = depths[np.minimum(starts, len(order) - 1)] if len(order) else np.zeros(slabs + 1, np.float32)
    return DepthSlabs(shapes, starts, splats.colors[order, :3], edges)


def slab_edge_channels(depths: Tensor, slabs: DepthSlabs) -> Tensor:
    """Shares of the two nearest slab edges, one channel per edge (n, edges), for scene splats at depths (n,).

    They are linear in depth and add up to 1; in front of all rain only the first edge, behind it only the last.
    """
    edges = torch.as_tensor(slabs.edges_m, device=depths.device)
    upper = torch.clamp(torch.searchsorted(edges, depths.contiguous()), 1, len(edges) - 1)
    low, high = edges[upper - 1], edges[upper]
    position = upper - 1 + torch.clamp((depths - low) / torch.clamp(high - low, min=1e-6), 0, 1)
    return torch.clamp(1 - torch.abs(position[:, None] - torch.arange(len(edges), device=depths.device)), min=0)


def composite_rain_slabs(
    rgba: Tensor, by_edge: Tensor, slabs: DepthSlabs, rain: RainFrame
) -> tuple[Tensor, Tensor | None]:
    """Composite rain with a scene: premultiplied display color and alpha (h, w, 4), and the rain's light of lamps.

    `rgba` is the clear scene, `by_edge` its weights (h, w, edges) from `slab_edge_channels`. With the scene's color B
    and alpha A, its share W_s and the rain's W_r under each other: enc(min(W_s / A, 1) dec(B) + W_r S) in linear light,
    as in `add_rain_light`; the display form is the same without enc and dec.
    """
    alpha = rgba[..., 3]
    is_lit = rain.lamp_light is not None and rain.is_linear
    rain_share, scene_share, lamp_light = _shares(by_edge, alpha, slabs, is_lit=is_lit)
    light = torch.as_tensor(rain.light_linear, device=rgba.device)
    visible = torch.where(alpha > 0, torch.clamp(scene_share / torch.clamp(alpha, min=1e-30), max=1), 1.0)[..., None]
    if rain.is_linear:
        color = _to_display(visible * _to_linear(rgba[..., :3]) + rain_share[..., None] * light)
    else:
        color = visible * rgba[..., :3] + rain_share[..., None] * _to_display(light)
    rainy = torch.cat([color, (rain_share + scene_share)[..., None]], dim=-1)
    return torch.where(rain_share[..., None] > 0, rainy, rgba), lamp_light


def _shares(by_edge: Tensor, alpha: Tensor, slabs: DepthSlabs, *, is_lit: bool) -> tuple[Tensor, Tensor, Tensor | None]:
    """Visible shares of rain and of scene through each other (h, w), and the rain's light of lamps (h, w, 3).

    See `composite_in_rain`. Inside a slab drops don't hide each other's light.
    """
    height, width = alpha.shape
    hidden = torch.where(alpha > _OPAQUE, 1 - alpha, 0.0)
    through_scene = 1 - hidden
    through_rain = torch.ones_like(alpha)
    rain_share, scene_share = torch.zeros_like(alpha), by_edge[..., 0]
    covers, lights = _covers(slabs, height, width, alpha.device, is_lit=is_lit)
    lamp_light = None if lights is None else torch.zeros((height, width, 3), device=alpha.device)
    for k, cover in enumerate(covers):
        through_scene = through_scene - by_edge[..., k]
        rain_share = rain_share + through_rain * cover * torch.clamp(through_scene, min=0)
        if lights is not None:
            lamp_light = lamp_light + (through_rain * torch.clamp(through_scene, min=0))[..., None] * lights[k]
        through_rain = through_rain * (1 - cover)
        scene_share = scene_share + through_rain * by_edge[..., k + 1]
    if lamp_light is not None:
        lamp_light = lamp_light * (1 + hidden)[..., None]
    return rain_share * (1 + hidden), scene_share, lamp_light


def _covers(
    slabs: DepthSlabs, height: int, width: int, device: Tensor, *, is_lit: bool
) -> tuple[Tensor, Tensor | None]:
    """Combined alpha of each slab's splats (slabs, h, w): 1 - prod (1 - alpha), in any order; and their light.

    The light is the sum of alpha times color (slabs, h, w, 3), None unless `is_lit`.
    """
    count = len(slabs.starts) - 1
    total = torch.zeros(count * height * width, dtype=torch.int64, device=device)
    lights = torch.zeros((len(total), 3), dtype=torch.int64, device=device) if is_lit else None
    colors = torch.as_tensor(slabs.colors, device=device)
    shapes = torch.as_tensor(slabs.shapes, device=device)
    image = torch.as_tensor(np.repeat(np.arange(count), np.diff(slabs.starts)), device=device)
    left = torch.clamp(torch.ceil(shapes[:, 0] - shapes[:, 7] - 0.5), 0, width).long()
    right = torch.clamp(torch.floor(shapes[:, 0] + shapes[:, 7] + 0.5), 0, width).long()
    splats, columns = _spread(left, right)
    for splat, column in zip(splats.split(_COLUMNS), columns.split(_COLUMNS), strict=True):
        places = image[splat] * (height * width) + column
        _add_columns(shapes[splat], column, places, (height, width), total, colors[splat], lights)
    covers = -torch.expm1(total.to(torch.float32) / _FIXED_POINT).reshape(count, height, width)
    if lights is None:
        return covers, None
    return covers, (lights.to(torch.float32) / _FIXED_POINT).reshape(count, height, width, 3)


def _add_columns(
    shapes: Tensor,
    columns: Tensor,
    places: Tensor,
    size: tuple[int, int],
    total: Tensor,
    colors: Tensor,
    lights: Tensor | None,
) -> None:
    """Add ln(1 - alpha) along one pixel column of each splat, starting at a position in `total`; see `Splats`.

    With `lights` add alpha times color there, too.
    """
    height, width = size
    x, y, shear, sharpness_x, sharpness_y, log_opacity, log_cut, _ = shapes.unbind(1)
    dx = columns + 0.5 - x
    peak = log_opacity + sharpness_x * dx * dx
    center = y + shear * dx
    half = torch.sqrt(torch.clamp((peak - log_cut) / -sharpness_y, min=0))
    top = torch.clamp(torch.ceil(center - half - 0.5), 0, height).long()
    bottom = torch.clamp(torch.floor(center + half + 0.5), 0, height).long()
    column, v = _spread(top, bottom)
    dy = v + 0.5 - center[column]
    alpha = torch.exp(peak[column] + sharpness_y[column] * dy * dy)
    logs = torch.log1p(-torch.clamp(alpha, max=float(MAX_ALPHA)))
    total.index_add_(0, places[column] + v * width, (logs * _FIXED_POINT).to(torch.int64))
    if lights is not None:
        light = alpha[:, None] * colors[column] * _FIXED_POINT
        lights.index_add_(0, places[column] + v * width, light.to(torch.int64))


def _lit_by_lamps(
    rgba: Tensor, depths: tuple[Tensor, Tensor] | None, drop_light: Tensor | None, lit: LampLight
) -> Tensor:
    """Add the light of lamps: that of drops, and with depths (weighted depth and weight) the medium's, from the CPU."""
    image = rgba.cpu().numpy().copy()
    light = np.zeros((*image.shape[:2], 3), np.float32)
    if depths is not None:
        light += light_in_picture(lit, *(np.ascontiguousarray(each.cpu().numpy()) for each in depths))
    if drop_light is not None:
        light += drop_light.cpu().numpy()
    add_light(image, light)
    return torch.as_tensor(image, device=rgba.device)


def _spread(starts: Tensor, ends: Tensor) -> tuple[Tensor, Tensor]:
    """Every integer from starts to before ends, and the index of its range."""
    counts = torch.clamp(ends - starts, min=0)
    owner = torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts)
    first = torch.cumsum(counts, 0) - counts
    return owner, torch.arange(len(owner), device=counts.device) - first[owner] + starts[owner]


def _to_linear(display: Tensor) -> Tensor:
    """Decode by the sRGB transfer function (IEC 61966-2-1)."""
    return torch.where(display > 0.04045, ((torch.clamp(display, min=0.04045) + 0.055) / 1.055) ** 2.4, display / 12.92)


def _to_display(linear: Tensor) -> Tensor:
    curve = 1.055 * torch.clamp(linear, min=0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(linear > 0.0031308, curve, 12.92 * linear)
