"""Light of lamps on the GPU: tables of a frame as textures, and the pass that adds it to a picture."""

from typing import Any

import moderngl
import numpy as np
from jaxtyping import Float32

from ...rain.lamp_light import LampLight

_UNITS = {"lamp_numbers": 4, "lamp_phase": 5, "lamp_table": 6}
"""Texture units; those of pictures are below."""


class LampTextures:
    """Tables of a `LampLight` as textures, uploaded once for each."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._lit: LampLight | None = None
        self._textures: list[moderngl.Texture | moderngl.Texture3D] = []

    def bind(self, lit: LampLight) -> dict[str, Any]:
        """Bind the textures, and return the uniforms of common_lamps.glsl, with those of the medium."""
        if lit is not self._lit:
            for texture in self._textures:
                texture.release()
            self._textures = [self._flat(lit.lamps), self._flat(np.stack([lit.sums, lit.drop_phase]))]
            if lit.table.size:
                rows, columns, slices, _ = lit.table.shape
                table = self._context.texture3d((slices, columns, rows), 3, lit.table.tobytes(), dtype="f4")
                table.filter = moderngl.NEAREST, moderngl.NEAREST
                self._textures.append(table)
            self._lit = lit
        for texture, unit in zip(self._textures, _UNITS.values(), strict=False):
            texture.use(unit)
        drawn = np.zeros(64, np.float32)
        drawn[: len(lit.drawn)] = lit.drawn
        return {
            "lamp_numbers": _UNITS["lamp_numbers"], "lamp_phase": _UNITS["lamp_phase"], "lamp_count": len(lit.lamps),
            "medium_numbers": lit.numbers.tolist(), "medium_drawn": drawn.tolist(),
        }  # fmt: skip

    def picture_uniforms(self, lit: LampLight) -> dict[str, Any]:
        """Bind the textures, and return the uniforms of lamp_light.frag but for its pictures."""
        shared = self.bind(lit)
        if not lit.table.size:
            return {}
        return {
            **shared, "lamp_table": _UNITS["lamp_table"], "cell_px": lit.cell_px,
            "intrinsics": tuple(lit.intrinsics.tolist()),
        }  # fmt: skip

    def _flat(self, numbers: Float32[np.ndarray, "h w"]) -> moderngl.Texture:
        texture = self._context.texture(numbers.shape[::-1], 1, numbers.astype(np.float32).tobytes(), dtype="f4")
        texture.filter = moderngl.NEAREST, moderngl.NEAREST
        return texture
