import time

import pytest

from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.street.build import StreetSurfaces, scene_of, street_surfaces


@pytest.fixture(scope="session")
def surfaces() -> StreetSurfaces:
    start = time.perf_counter()
    built = street_surfaces()
    print(f"\nsurfaces of the street: {time.perf_counter() - start:.2f} s")
    return built


@pytest.fixture(scope="session")
def street(surfaces: StreetSurfaces) -> Scene:
    start = time.perf_counter()
    scene = scene_of(surfaces)
    print(f"\nGaussians of the street: {time.perf_counter() - start:.2f} s, {scene.gaussian_count}")
    return scene
