"""The first half of a frame on the GPU: Gaussians become splats, and those that can be seen move together."""

from collections.abc import Sequence

import moderngl
import numpy as np

from gsrain_engine.rain.rain_gaussians import RainGaussians
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Part

from .depth_sort import KEYS, SLOTS, DepthSort
from .gpu_arrays import CHUNK, SH_BITS, GpuArrays
from .heat_colors import layer_color
from .host_sort import HostSort
from .look import Look
from .shaders import load_compute_shader
from .splat_store import SLOTS_BY_BLOCK, SplatStore

NEAR_M = 0.2
"""Gaussians whose centre is nearer than this are left out, as in the reference rasterizer."""

_LOOKS: dict[Look, int] = {"points": 1, "normals": 2, "opacity": 3, "layers": 4}
"""Looks that change what a Gaussian is projected to; as in splat_project.comp."""

_LONGEST_DISPATCH = 1 << 15
"""Workgroups along one axis, half of what every driver allows."""


class ProjectionPass:
    """Fills a store with the splats of a frame."""

    def __init__(self, context: moderngl.Context, arrays: GpuArrays) -> None:
        self._context = context
        self._arrays = arrays
        self._scan = load_compute_shader(context, "visible_scan.comp")
        self._gather = load_compute_shader(context, "visible_gather.comp")
        self._projectors: dict[tuple[int, ...], moderngl.ComputeShader] = {}

    def project(
        self, store: SplatStore, parts: Sequence[Part], camera: Camera, rain: RainGaussians | None, look: Look
    ) -> int:
        """Write the visible splats of parts and rain into the store; returns how many slots they have there."""
        rows = [(part, False) for part in parts]
        if rain is not None:
            rows.append((Part(rain.gaussians, np.eye(4)), True))
        slots = sum(_slots(part.count) for part, _ in rows)
        store.reserve(slots)
        store.bind()
        shader = self._projector(store)
        _set_camera(shader, camera)
        shader["camera_to_world"] = tuple(camera.camera_to_world[:3, :3].T.ravel())
        shader["look"] = _LOOKS.get(look, 0)
        first = 0
        for number, (part, is_rain) in enumerate(rows):
            shader["layer_color"] = layer_color(number)
            shader["is_rain"] = is_rain
            self._dispatch(shader, part, camera, first)
            first += _slots(part.count)
        self._context.memory_barrier()
        return slots

    def bring_together(self, store: SplatStore, sort: DepthSort | HostSort, slots: int) -> None:
        """Pack the keys of all visible splats into what the sort takes, and tell it and the draw how many they are."""
        blocks = slots // SLOTS_BY_BLOCK
        sort.reserve(max(slots, 1))
        store.bind()
        self._scan["blocks"] = blocks
        self._scan.run()
        self._context.memory_barrier()
        for binding, buffer in zip((KEYS, SLOTS), sort.unsorted, strict=True):
            buffer.bind_to_storage_buffer(binding)
        self._gather["blocks"] = blocks
        self._gather.run(min(blocks, _LONGEST_DISPATCH), -(-blocks // _LONGEST_DISPATCH))
        self._context.memory_barrier()

    def _dispatch(self, shader: moderngl.ComputeShader, part: Part, camera: Camera, first: int) -> None:
        gaussians = part.gaussians
        object_to_camera = camera.world_to_camera @ part.to_world
        shader["coefficients"] = gaussians.sh.shape[1]
        shader["object_to_camera"] = tuple(object_to_camera.T.ravel())
        shader["camera_in_object"] = tuple(np.linalg.inv(object_to_camera)[:3, 3])
        for index, chunk in enumerate(self._arrays.buffers(gaussians).chunks()):
            count = min(CHUNK, part.count - index * CHUNK)
            if count <= 0:
                break
            for binding, buffer in enumerate(chunk):
                buffer.bind_to_storage_buffer(binding)
            shader["count"] = count
            shader["first_slot"] = first + index * CHUNK
            shader.run(-(-count // SLOTS_BY_BLOCK))

    def _projector(self, store: SplatStore) -> moderngl.ComputeShader:
        switches = {**store.switches, "SH_BITS": SH_BITS[self._arrays.harmonics]}
        key = tuple(switches.values())
        if key not in self._projectors:
            self._projectors[key] = load_compute_shader(self._context, "splat_project.comp", switches)
        return self._projectors[key]


def _set_camera(shader: moderngl.ComputeShader, camera: Camera) -> None:
    shader["intrinsics"] = (camera.fx, camera.fy, camera.cx, camera.cy)
    shader["image_size"] = (camera.width, camera.height)
    shader["near"] = NEAR_M


def _slots(count: int) -> int:
    return -(-count // SLOTS_BY_BLOCK) * SLOTS_BY_BLOCK
