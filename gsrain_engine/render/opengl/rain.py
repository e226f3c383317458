"""Rain on the GPU: find, expand and project drops; uploads how far each diameter class has fallen."""

import moderngl
import numpy as np
from jaxtyping import Float32, Float64, Shaped, UInt32

from ...rain.drop_field import FIRST_OF_CLASS
from ...rain.frame import RainFrame
from ...rain.properties import CLASSES
from ...rain.shelter_map import ShelterMap
from ..cpu.splats import NEAR_M
from .buffers import SLOTS_BY_BLOCK, WORK_BYTES, GrowableBuffer, ProjectedSplatBuffer
from .lamps import LampTextures
from .shaders import ComputeShader, ShaderVariants
from .sort import PrefixSum, count_in

_MOVED, _CLASS_ROWS, _FOUND, _PLACES, _ROOFS, _COUNTS, _FOUND_WORK = 0, 1, 2, 3, 3, 5, 6
_IN_THE_OPEN = np.float32(-1e9)  # replacement for a roof height of -inf in shaders


class RainPass:
    """Writes the streaks at one time into a `ProjectedSplatBuffer`, after the scene's splats."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._find, self._streaks = (ShaderVariants(context, f"rain_{name}.comp") for name in ("find", "streaks"))
        self._find({})
        self._scan = PrefixSum(context)
        self.lamps = LampTextures(context)
        self._moved, self._classes, self._found, self._counts, self._roofs = (GrowableBuffer(context) for _ in range(5))
        self._class_arrays: tuple[Shaped[np.ndarray, "classes ..."], ...] = ()
        self._masks_by_class = 1
        self.work = context.buffer(np.zeros(WORK_BYTES // 4, np.uint32))
        """Number of found drops; see `WORK_BYTES`."""

    def find(self, field: RainFrame) -> None:
        """Find the drops that may be visible to the camera."""
        self._masks_by_class = max(1, -(-field.count // (CLASSES * 32)))
        masks = self._masks_by_class * CLASSES
        self._write_classes(field)
        self._found.reserve(4 * masks)
        self._counts.reserve(4 * masks)
        shader, culling = self._find({} if field.roofs is None else {"ROOFS": 1}), field.culling
        self._set_field(shader, field)
        shader.set(count=field.count, cell_to_region=_columns(culling.region_rotation),
            region_half=tuple(culling.region_half), slopes=tuple(culling.slopes),
        )  # fmt: skip
        self._bind(_COUNTS)
        if field.roofs is not None:
            self._set_roofs(shader, field, field.roofs)
        shader.run(masks // 256)
        self._context.memory_barrier()
        self._scan.run(self._counts.buffer, self.work, masks, max_elements=field.max_drops)

    def project(self, store: ProjectedSplatBuffer, field: RainFrame, first_slot: int) -> None:
        """Turn the found drops into streaks and write the visible ones."""
        lit = field.lamp_light if field.is_linear else None
        shader, shutter, rain = (
            self._streaks({**store.switches, **({} if lit is None else {"LAMPS": 1})}), field.shutter, field.rain
        )  # fmt: skip
        camera = shutter.camera
        seen_from = np.zeros(3) if rain.is_paper else field.axes.T @ shutter.velocity_m_s
        self._set_field(shader, field)
        shader.set(exposure=shutter.exposure_s, shutter_velocity=tuple(seen_from),
            still_camera=rain.is_paper, focal=shutter.focal_px,
            phi=rain.critical_haze_coefficient, haze_opacity=rain.haze_opacity, gain=rain.streak_gain,
            aperture=shutter.lens.aperture_m, focus=shutter.lens.focus_m, scan=tuple(shutter.readout),
            max_copies=rain.max_copies,
            near=NEAR_M, first_slot=first_slot,
            intrinsics=(camera.fx, camera.fy, camera.cx, camera.cy), image_size=(camera.width, camera.height),
            rows_outside=camera.rows_outside,
            **({"display_color": tuple(field.color)} if lit is None else self.lamps.bind(lit)),
        )  # fmt: skip
        store.bind()
        self._bind(_PLACES)
        self.work.bind_to_storage_buffer(_FOUND_WORK)
        shader.run(-(-field.max_drops // SLOTS_BY_BLOCK))

    def found_count(self) -> int:
        """Number of drops found last; waits for the GPU."""
        return count_in(self.work)

    def found(self) -> UInt32[np.ndarray, " m"]:
        """Numbers of the drops found last, class by class; waits for the GPU."""
        size = 4 * self._masks_by_class * CLASSES
        masks = np.frombuffer(self._found.buffer.read(size), np.uint32)
        bits = (masks[:, None] >> np.arange(32, dtype=np.uint32)) & np.uint32(1)
        at, bit = np.nonzero(bits)
        class_index, group = np.divmod(at, self._masks_by_class)
        return ((group * 32 + bit) * CLASSES + class_index * FIRST_OF_CLASS % CLASSES).astype(np.uint32)

    def _set_field(self, shader: ComputeShader, field: RainFrame) -> None:
        shader.set(masks_by_class=self._masks_by_class, first_of_class=FIRST_OF_CLASS, seed=field.rain.seed,
            period=tuple(field.period_m), camera_in_cell=tuple(field.culling.camera_position),
            cell_to_camera=_columns(field.culling.cell_to_camera),
        )  # fmt: skip

    def _set_roofs(self, shader: ComputeShader, field: RainFrame, roofs: ShelterMap) -> None:
        heights = np.maximum(roofs.heights_m - np.float32(field.center_m[2]), _IN_THE_OPEN)
        self._roofs.reserve(heights.nbytes).write(heights)
        self._roofs.bind(_ROOFS)
        rows, columns = heights.shape
        shader.set(roof_size=(columns, rows), roof_corner=tuple(np.array(roofs.corner_m) - field.center_m[:2]),
            roof_edge=roofs.cell_m, cell_to_world=_columns(field.axes[:2, :2]),
        )  # fmt: skip

    def _write_classes(self, field: RainFrame) -> None:
        """Upload what has moved; and the constants of the classes, if they changed."""
        words = moved_words(field)
        self._moved.reserve(words.nbytes).write(words)
        far_m, margin_m, air = field.culling.class_far_m, field.culling.class_margin_m, field.where.air
        arrays = far_m, margin_m, field.diameters_mm, field.fall_speed_m_s, air.by_class
        if not (self._class_arrays and all(map(np.array_equal, arrays, self._class_arrays))):
            rows = class_rows(field)
            self._classes.reserve(rows.nbytes).write(rows)
            self._class_arrays = arrays

    def _bind(self, counts_binding: int) -> None:
        self._moved.bind(_MOVED)
        self._classes.bind(_CLASS_ROWS)
        self._found.bind(_FOUND)
        self._counts.bind(counts_binding)


def streak_slots(field: RainFrame) -> int:
    return -(-field.max_drops // SLOTS_BY_BLOCK) * SLOTS_BY_BLOCK * field.rain.max_copies


def moved_words(field: RainFrame) -> UInt32[np.ndarray, " words"]:
    """The air, and the offsets of all classes, in the layout of common_drop_field.glsl."""
    air, wraps, fractions = field.where.air, field.where.wraps.view(np.uint32), field.where.fractions
    fallen = np.stack([wraps[:, 2], fractions[:, 2]], axis=1)
    across = [wraps[0, :2], fractions[0, :2]]
    return np.concatenate([air.numbers.view(np.uint32), air.rows.view(np.uint32).ravel(), *across, fallen.ravel()])


def class_rows(field: RainFrame) -> Float32[np.ndarray, "classes 7"]:
    """Constants of each class, in the layout of common_drop_field.glsl."""
    rows = np.empty((CLASSES, 7), np.float32)
    rows[:, 0], rows[:, 1] = field.culling.class_far_m, field.culling.class_margin_m
    rows[:, 2], rows[:, 3], rows[:, 4:] = 1e-3 * field.diameters_mm, field.fall_speed_m_s, field.where.air.by_class
    return rows


def _columns(matrix: Float64[np.ndarray, "n n"]) -> tuple[float, ...]:
    return tuple(matrix.T.ravel())
