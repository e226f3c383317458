"""Visibility of rain: fractions of changed pixels and optical depths by intensity and seed, on the built-in street.

Prints JSON. A pixel counts as changed when a channel differs by more than 4/255 from the same still without rain.
Optical depth is the mean of -ln(1 - alpha) of the paper's haze Gaussians alone, drawn over nothing.
"""

import json
from dataclasses import replace

import msgspec
import numpy as np

from gsrain_engine.editor.viewport.camera import default_path
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.view import rain_camera
from gsrain_engine.scene.open import load_built_in
from gsrain_engine.scene.scene import Scene

SEEDS, INTENSITIES, SIZE = 5, ("1.2", "8.5", "12.0"), (960, 640)
STREAKS, HAZE = {"haze": "none"}, {"streaks": False}


def main() -> None:
    """Measure and print."""
    street = load_built_in()
    rows = [measure(street, load_preset(name), seed) for name in INTENSITIES for seed in range(SEEDS)]
    rows.append(measure(street, load_preset("paper"), 0) | {"preset": "paper"})
    advice = StreetStills(street).advice()
    print(json.dumps({"scene": street.name, "size": SIZE, "rows": rows, "advice_percent": advice}, indent=1))


class StreetStills:
    """Stills of the street 2 s into the default drive, and how far streaks alone move their pixels."""

    def __init__(self, street: Scene) -> None:
        self._street, self._renderer = street, CpuRenderer()
        path = default_path(street, *SIZE)
        sequence = FrameSequence(street, RainSimulation.start(load_preset("clear")), path, *SIZE, start_s=2.0)
        self._shot, self._sky = sequence.shot(0), sequence.sky(self._renderer).light
        self.clear = self._still(load_preset("clear"))

    def advice(self) -> dict[str, float]:
        """Return the percentages of the table in docs/faq.md, in its order."""
        brightest = self.clear.max(axis=-1)
        everywhere = np.ones(brightest.shape, bool)
        rows: list[tuple[str, np.ndarray, dict[str, object]]] = [
            ("as it is", everywhere, {}),
            ("dark", brightest < 80, {}),
            ("bright", brightest > 180, {}),
            ("rain 25", everywhere, {"intensity_mm_h": 25.0}),
            ("rain 50", everywhere, {"intensity_mm_h": 50.0}),
            ("exposure 0.001", everywhere, {"exposure_s": 0.001}),
            ("exposure 0.02", everywhere, {"exposure_s": 0.02}),
            ("streak_gain 3", everywhere, {"streak_gain": 3.0}),
        ]
        return {name: self.moved_percent(where, **fields) for name, where, fields in rows}

    def moved_percent(self, where: np.ndarray, **fields: object) -> float:
        """Percentage of some pixels that streaks alone move by more than 8 of 255 levels in a channel."""
        rainy = self._still(msgspec.structs.replace(load_preset("8.5"), **STREAKS, **fields))
        moved = np.abs(rainy.astype(int) - self.clear).max(axis=-1) > 8
        return 100 * float(moved[where].mean())

    def _still(self, rain: RainSettings) -> np.ndarray:
        shot = self._shot
        rainfall = RainSimulation.start(rain)
        falling = rainfall.frame(shot.time_s, rain_camera(self._street, rainfall, shot), self._sky)
        self._renderer.draw(self._street.parts(2.0), shot.camera, falling)
        return self._renderer.read().to_uint8()


def measure(street: Scene, rain: RainSettings, seed: int) -> dict[str, float]:
    """Figures of one still, 2 s into the default drive."""
    renderer = CpuRenderer()
    path = default_path(street, *SIZE)

    def still(scene: Scene, **fields: object) -> np.ndarray:
        falling = RainSimulation.start(msgspec.structs.replace(rain, seed=seed, **fields))
        sequence = FrameSequence(scene, falling, path, *SIZE, start_s=2.0)
        shot, sky = sequence.shot(0), sequence.sky(renderer)
        renderer.draw(
            scene.parts(2.0) if scene.layers else [],
            shot.camera,
            falling.frame(shot.time_s, rain_camera(street, falling, shot), sky.light),
        )
        return renderer.read().rgba

    clear, streaked, hazed, both = (still(street, **fields) for fields in ({"intensity_mm_h": 0.0}, STREAKS, HAZE, {}))
    veil = still(replace(street, layers=(), actors=()), haze="gaussians", streaks=False)[..., 3].astype(np.float64)
    return {
        "intensity_mm_h": rain.intensity_mm_h,
        "seed": seed,
        "streaks_changed_share": changed_share(streaked, clear),
        "streaks_mean_levels": mean_levels(streaked, clear),
        "streaks_largest_levels": float(np.abs(streaked - clear)[..., :3].max() * 255),
        "haze_changed_share": changed_share(hazed, clear),
        "changed_share": changed_share(both, clear),
        "haze_optical_depth": float(np.mean(-np.log1p(-np.minimum(veil, 1 - 1e-9)))),
    }


def changed_share(rainy: np.ndarray, clear: np.ndarray) -> float:
    """Share of pixels that differ by more than 4/255 in a channel."""
    return float(np.mean(np.abs(rainy - clear)[..., :3].max(axis=-1) > 4 / 255))


def mean_levels(rainy: np.ndarray, clear: np.ndarray) -> float:
    """Mean absolute difference in gray levels of 255."""
    return float(np.abs(rainy - clear)[..., :3].mean() * 255)


if __name__ == "__main__":
    main()
