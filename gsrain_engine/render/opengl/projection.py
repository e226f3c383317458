"""Projection on the GPU: Gaussians and drops to splats, and compaction of the visible ones."""

from collections.abc import Sequence
from typing import NamedTuple

import moderngl
import numpy as np

from ...rain.simulation import RainFrame
from ...scene.camera import Camera
from ...scene.scene import DrawItem
from ..images import layer_color
from ..renderer import RenderMode
from .buffers import CHUNK, NEAR_M, SH_BITS, SLOTS_BY_BLOCK, GpuArrays, ProjectedSplatBuffer
from .prefix_sum import PrefixSum
from .rain import RainPass, streak_slots
from .shaders import load_compute_shader
from .sort import KEYS, KEYS_BY_GROUP, SLOTS, CpuSort, DepthSort

_LOOKS: dict[RenderMode, int] = {"points": 1, "normals": 2, "opacity": 3, "layers": 4}
"""Render modes that change the projection of a Gaussian; as in splat_project.comp."""

_LONGEST_DISPATCH = 1 << 15  # workgroups along one axis, half of the limit guaranteed by OpenGL
_MARKS = 6  # binding of the masks: the last of the eight guaranteed storage bindings
_WET = 12
"""Binding of the wet colors, after all blocks of records. Only the shader that blends them uses this ninth block."""

_SAME_COLORS = np.eye(3, 4)


class FrameSlots(NamedTuple):
    """Slots of a frame in a `ProjectedSplatBuffer`."""

    all: int
    fixed: int
    """Slots of Gaussians, which come first; the rest are for streaks, whose number only the GPU has."""
    copies: int
    """Blocks per group of drops."""


class ProjectionPass:
    """Fills a `ProjectedSplatBuffer` with the splats of a frame."""

    def __init__(self, context: moderngl.Context, arrays: GpuArrays) -> None:
        self._context = context
        self._arrays = arrays
        self._scan = PrefixSum(context)
        self._gather = load_compute_shader(context, "visible_gather.comp")
        self._projectors: dict[tuple[int, ...], moderngl.ComputeShader] = {}
        self.drops = RainPass(context)

    def project(
        self,
        store: ProjectedSplatBuffer,
        parts: Sequence[DrawItem],
        camera: Camera,
        rain: RainFrame | None,
        look: RenderMode,
    ) -> FrameSlots:
        rows = [(part if part.opacity > 0 else part._replace(limit=0), False) for part in parts]
        field = rain.streak_field if rain is not None else None
        if rain is not None:
            rows.append((DrawItem(rain.haze_gaussians, np.eye(4)), True))
        fixed = sum(_slots(part.drawn_count) for part, _ in rows)
        slots = FrameSlots(fixed + (streak_slots(field) if field else 0), fixed, field.rain.max_copies if field else 0)
        store.reserve(slots.all)
        if field is not None:
            self.drops.find(field)
        is_wet = any(part.is_wet for part, _ in rows)
        shader = self._projector(store, wet=is_wet)
        shader["intrinsics"] = (camera.fx, camera.fy, camera.cx, camera.cy)
        shader["image_size"] = (camera.width, camera.height)
        shader["near"] = NEAR_M
        shader["camera_to_world"] = tuple(camera.camera_to_world[:3, :3].T.ravel())
        shader["look"] = _LOOKS.get(look, 0)
        store.bind()
        first = 0
        for number, (part, is_rain) in enumerate(rows):
            shader["layer_color"] = layer_color(number)
            shader["is_rain"] = is_rain
            if is_wet:
                shader["wetness"] = part.wetness if part.is_wet else 0.0
            self._dispatch(shader, part, camera, first)
            first += _slots(part.drawn_count)
        if field is not None and rain is not None:
            self.drops.project(store, field, rain.color, fixed)
        self._context.memory_barrier()
        return slots

    def compact_visible(self, store: ProjectedSplatBuffer, sort: DepthSort | CpuSort, slots: FrameSlots) -> None:
        """Compact the keys of all visible splats for the sort, and write their number for the sort and the draw."""
        blocks = slots.all // SLOTS_BY_BLOCK
        sort.reserve(max(slots.all, 1))
        found = (self.drops.work, slots.fixed // SLOTS_BY_BLOCK, slots.copies) if slots.copies else None
        self._scan.run(store.counts.buffer, store.work, blocks, by_group=KEYS_BY_GROUP, found=found)
        store.bind()
        for binding, buffer in zip((KEYS, SLOTS), sort.unsorted, strict=True):
            buffer.bind_to_storage_buffer(binding)
        self._gather["blocks"] = blocks
        self._gather.run(min(blocks, _LONGEST_DISPATCH), -(-blocks // _LONGEST_DISPATCH))
        self._context.memory_barrier()

    def _dispatch(self, shader: moderngl.ComputeShader, part: DrawItem, camera: Camera, first: int) -> None:
        gaussians = part.gaussians
        object_to_camera = camera.world_to_camera @ part.to_world
        colors = _SAME_COLORS if part.colors is None else part.colors
        marks = self._arrays.marks(part.left_out, part.selected)
        buffers = self._arrays.buffers(gaussians, part.wet_sh if part.is_wet else None)
        if not part.is_wet:
            self._arrays.keep(part.wet_sh)
        shader["growth"] = part.growth
        shader["layer_opacity"] = part.opacity
        shader["color_change"] = tuple(colors.T.ravel())
        shader["has_marks"] = bool(marks)
        shader["coefficients"] = gaussians.sh.shape[1]
        shader["object_to_camera"] = tuple(object_to_camera.T.ravel())
        shader["camera_in_object"] = tuple(np.linalg.inv(object_to_camera)[:3, 3])
        for index, chunk in enumerate(buffers.chunks()):
            count = min(CHUNK, part.drawn_count - index * CHUNK)
            if count <= 0:
                break
            for binding, buffer in enumerate(chunk):
                buffer.bind_to_storage_buffer(binding)
            if marks:
                marks[index].bind_to_storage_buffer(_MARKS)
            if buffers.wet_sh:
                buffers.wet_sh[index].bind_to_storage_buffer(_WET)
            shader["count"] = count
            shader["first_slot"] = first + index * CHUNK
            shader.run(-(-count // SLOTS_BY_BLOCK))

    def _projector(self, store: ProjectedSplatBuffer, *, wet: bool) -> moderngl.ComputeShader:
        switches = {**store.switches, "SH_BITS": SH_BITS[self._arrays.harmonics]} | ({"WET": 1} if wet else {})
        key = tuple(switches.values())
        if key not in self._projectors:
            self._projectors[key] = load_compute_shader(self._context, "splat_project.comp", switches)
        return self._projectors[key]


def _slots(count: int) -> int:
    return -(-count // SLOTS_BY_BLOCK) * SLOTS_BY_BLOCK
