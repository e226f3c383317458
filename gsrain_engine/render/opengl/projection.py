"""Projection on the GPU: Gaussians and drops to splats, and compaction of the visible ones."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import moderngl
import numpy as np

from ...choices import RenderMode
from ...rain.frame import RainFrame
from ...rain.medium import RainMedium
from ...scene.camera import Camera
from ...scene.scene import DrawItem
from ..cpu.lens_projection import lens_view, rolling_pose
from ..cpu.splats import nearest_m
from ..images import layer_color
from .buffers import CHUNK, SH_BITS, SLOTS_BY_BLOCK, GaussianBuffers, GpuArrays, ProjectedSplatBuffer
from .rain import RainPass, streak_slots
from .shaders import ComputeShader, ShaderVariants, load_compute_shader
from .sort import KEYS, SLOTS, CpuSort, PrefixSum, RadixSort

_MODES: dict[RenderMode, int] = {"points": 1, "normals": 2, "opacity": 3, "layers": 4}
"""Render modes that change the projection of a Gaussian; as in splat_project.comp."""

_MARKS = 6  # binding of the masks: the last of the eight guaranteed storage bindings
_WET = 12
"""Binding of the wet colors, after all blocks of records. Only the shader that blends them uses this ninth block."""


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
        self._projector = ShaderVariants(context, "splat_project.comp")
        self.drops = RainPass(context)

    def project(
        self,
        store: ProjectedSplatBuffer,
        parts: Sequence[DrawItem],
        camera: Camera,
        rain: RainFrame | None,
        mode: RenderMode,
    ) -> FrameSlots:
        rows = [
            (_rising(part) if part.opacity > 0 and part.drawn_count else part._replace(limit=0, members=None), False)
            for part in parts
        ]
        view = None if camera.is_pinhole else lens_view(camera)
        field = rain if rain is not None and rain.draws_drops and view is None else None
        if rain is not None:
            rows.append((DrawItem(rain.drawn_haze, np.eye(4)), True))
            if view is not None:  # drops are found on the processor, each at the time of its row
                rows.append((DrawItem(rain.lit_streaks, np.eye(4)), True))
        fixed = sum(_slots(each.gaussians) for part, _ in rows for each in _drawn_in_chunks(part))
        slots = FrameSlots(fixed + (streak_slots(field) if field else 0), fixed, field.rain.max_copies if field else 0)
        store.reserve(slots.all)
        if field is not None:
            self.drops.find(field)
        is_wet = any(part.is_wet for part, _ in rows)
        wet = {"WET": 1} if is_wet else {}
        medium = rain.medium if rain is not None else None
        dims = {"MEDIUM": 1} if medium is not None else {}
        bent = {} if view is None else {"LENS": 1}
        switches = {**store.switches, "SH_BITS": SH_BITS[self._arrays.harmonics], **wet, **dims, **bent}
        frame: dict[str, Any] = {
            "intrinsics": (camera.fx, camera.fy, camera.cx, camera.cy), "image_size": (camera.width, camera.height),
            "near": nearest_m(camera), "camera_to_world": tuple(camera.camera_to_world[:3, :3].T.ravel()),
            "look": _MODES.get(mode, 0),
        }  # fmt: skip
        if rain is not None and medium is not None:
            frame |= {"is_linear": rain.is_linear, **medium_uniforms(medium)}
            if view is not None:
                frame["medium_by_distance"] = medium.by_distance
        if view is None:
            frame["rows_outside"] = camera.rows_outside
        else:
            frame |= {
                "lens": view.lens.tolist(), "scan": tuple(view.scan.tolist()), "by_distance": view.by_distance,
                "edges": tuple(np.clip(view.edges, -1e30, 1e30).tolist()),
            }  # fmt: skip
        store.bind()
        first = 0
        streaks = len(rows) - 1 if view is not None and rain is not None else None
        for number, (part, is_rain) in enumerate(rows):
            shader = self._projector(switches if part.members is None else {**switches, "MEMBERS": 1})
            shader.set(layer_color=layer_color(number), is_rain=is_rain, **frame)
            if view is not None:
                shader.set(**_changes(part, camera, is_held=number == streaks))
            if is_wet:
                shader.set(wetness=part.wetness if part.is_wet else 0.0)
            gaussians, wet_sh = part.gaussians, part.wet_sh if part.is_wet else None
            buffers = self._arrays.passing_buffers(gaussians) if is_rain else self._arrays.buffers(gaussians, wet_sh)
            first = self._dispatch(shader, part, buffers, camera, first)
        if field is not None:
            self.drops.project(store, field, fixed)
        self._context.memory_barrier()
        return slots

    def compact_visible(self, store: ProjectedSplatBuffer, sort: RadixSort | CpuSort, slots: FrameSlots) -> None:
        """Compact the keys of all visible splats for the sort, and write their number for the sort and the draw."""
        blocks = slots.all // SLOTS_BY_BLOCK
        sort.reserve(max(slots.all, 1))
        found = (self.drops.work, slots.fixed // SLOTS_BY_BLOCK, slots.copies) if slots.copies else None
        self._scan.run(store.counts.buffer, store.work, blocks, found=found)
        store.bind()
        for binding, buffer in zip((KEYS, SLOTS), sort.unsorted, strict=True):
            buffer.bind_to_storage_buffer(binding)
        self._gather.set(blocks=blocks)
        self._gather.run_all(blocks)
        self._context.memory_barrier()

    def _dispatch(
        self, shader: ComputeShader, part: DrawItem, buffers: GaussianBuffers, camera: Camera, first: int
    ) -> int:
        """Project a part into the slots from `first` on; returns the next free one."""
        gaussians = part.gaussians
        object_to_camera = camera.world_to_camera @ part.to_world
        colors = np.eye(3, 4) if part.colors is None else part.colors
        if not part.is_wet:
            self._arrays.keep(part.wet_sh)
        shader.set(growth=part.growth, layer_opacity=part.opacity, color_change=tuple(colors.T.ravel()),
            coefficients=gaussians.sh.shape[1], antialiased=gaussians.antialiased,
            object_to_camera=tuple(object_to_camera.T.ravel()),
            camera_in_object=tuple(np.linalg.inv(object_to_camera)[:3, 3]),
        )  # fmt: skip
        marks: list[moderngl.Buffer] = []
        if part.members is not None:
            self._arrays.members(part.members, part.selected).bind_to_storage_buffer(_MARKS)
        else:
            marks = self._arrays.marks(part.left_out, part.selected)
            shader.set(has_marks=bool(marks))
        chunks = list(buffers.chunks())
        for drawn in _drawn_in_chunks(part):
            for binding, buffer in enumerate(chunks[drawn.chunk]):
                buffer.bind_to_storage_buffer(binding)
            if marks:
                marks[drawn.chunk].bind_to_storage_buffer(_MARKS)
            if buffers.wet_sh:
                buffers.wet_sh[drawn.chunk].bind_to_storage_buffer(_WET)
            if part.members is not None:
                shader.set(first_member=drawn.first_member)
            shader.set(count=drawn.gaussians, first_slot=first)
            shader.run(-(-drawn.gaussians // SLOTS_BY_BLOCK))
            first += _slots(drawn.gaussians)
        return first


def _changes(part: DrawItem, camera: Camera, *, is_held: bool) -> dict[str, Any]:
    """Uniforms of a part's motion during the readout, of points in the camera's frame."""
    pose = rolling_pose(part, camera, is_held=is_held)
    first, second = pose.matrices[1:] @ np.linalg.inv(pose.matrices[0])
    return {
        "moves": pose.moves, "first_change": tuple(first.T.ravel()), "second_change": tuple(second.T.ravel()),
        "camera_changes": [tuple(each) for each in pose.eyes[1:].tolist()],
    }  # fmt: skip


class _DrawnInChunk(NamedTuple):
    """Gaussians of a chunk of buffers that are drawn: its first ones, or some members."""

    chunk: int
    gaussians: int
    first_member: int = 0


def _drawn_in_chunks(part: DrawItem) -> list[_DrawnInChunk]:
    if part.members is None:
        starts = range(0, part.drawn_count, CHUNK)
        return [_DrawnInChunk(at // CHUNK, min(CHUNK, part.drawn_count - at)) for at in starts]
    ends = np.searchsorted(part.members, range(0, len(part.gaussians) + CHUNK, CHUNK)).tolist()
    return [_DrawnInChunk(n, ends[n + 1] - at, at) for n, at in enumerate(ends[:-1]) if ends[n + 1] > at]


def _rising(part: DrawItem) -> DrawItem:
    """Return a part whose members rise."""
    members = part.members
    return part if members is None or np.all(members[1:] > members[:-1]) else part._replace(members=np.sort(members))


def medium_uniforms(medium: RainMedium) -> dict[str, Any]:
    """Uniforms of common_medium.glsl."""
    numbers, drawn = medium.numbers.tolist(), medium.drawn.tolist()
    return {"medium_numbers": numbers, "medium_drawn": drawn, "airlight": tuple(medium.airlight_linear.tolist())}


def sky_uniforms(medium: RainMedium) -> dict[str, Any]:
    """Uniforms of shaders that draw the airlight behind the scene."""
    return medium_uniforms(medium) | {"medium_floor": tuple(medium.floor.tolist())}


def _slots(count: int) -> int:
    return -(-count // SLOTS_BY_BLOCK) * SLOTS_BY_BLOCK
