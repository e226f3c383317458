"""The built-in street and a short one, each built once in a test process, and numbers that describe its parts.

After a deliberate change of the street, `python -m tests.extras.street.built_street` writes these numbers anew.
"""

import json
from functools import cache
from pathlib import Path

import numpy as np

from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.scene import Scene
from gsrain_extras.street.build import StreetSurfaces, scene_of, street_surfaces
from gsrain_extras.street.layout import StreetParameters
from gsrain_extras.street.mesh import Quads

WHOLE = StreetParameters()
SHORT = StreetParameters(length_m=120.0, parked_share=0.3, tree_spacing_m=30.0)
"""A third of the Gaussians."""
MOMENTS = Path(__file__).parents[2] / "golden" / "street.json"
"""`moments_of` the whole street, as it was."""


@cache
def surfaces_of(parameters: StreetParameters) -> StreetSurfaces:
    return street_surfaces(parameters)


@cache
def street_of(parameters: StreetParameters) -> Scene:
    return scene_of(surfaces_of(parameters))


def moments_of(surfaces: StreetSurfaces) -> dict[str, dict[str, float | list[float]]]:
    """Return numbers of each layer and label: quads, their whole area (m^2), and means of all attributes over quads.

    Means of the cosine of 40 rad/m change with a few quads that have moved by a centimeter.
    """
    return {
        f"{name}, {Label(label).name.lower()}": _moments(quads, quads.labels == label)
        for name, quads in {**surfaces.layers, "lead": surfaces.lead}.items()
        for label in np.unique(quads.labels)
    }


def _moments(quads: Quads, chosen: np.ndarray) -> dict[str, float | list[float]]:
    diagonals = quads.corners[:, 2:] - quads.corners[:, :2]
    crossed = np.cross(*np.moveaxis(diagonals[chosen].astype(np.float64), 1, 0))
    places = quads.centers.astype(np.float64)
    attributes = {"places": places, "cosines": np.cos(40 * places)} | {
        name: getattr(quads, name)
        for name in ("albedo", "emission", "sky_access", "sun_access", "gloss", "opacity", "spread", "shift")
    }
    means = {name: each[chosen].mean(axis=0, dtype=np.float64).tolist() for name, each in attributes.items()}
    return {"quads": len(crossed), "area": 0.5 * float(np.linalg.norm(crossed, axis=1).sum()), **means}


if __name__ == "__main__":
    MOMENTS.write_text(json.dumps(moments_of(surfaces_of(WHOLE)), indent=1) + "\n", encoding="utf-8")
