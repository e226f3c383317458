"""gsrain_engine.api, which programs imported from before there was `gsrain`: its names, and what they cost."""

import subprocess
import sys

import pytest

from gsrain_engine import api


def test_every_name_is_there():
    for name in dir(api):
        found = getattr(api, name)
        assert getattr(found, "__name__", name) == name
    assert api.RENAMED["Session"] == "Editor" and len(api.RENAMED) == 21
    for old, name in api.RENAMED.items():
        assert getattr(api, old) is getattr(api, name)
    with pytest.raises(AttributeError, match="gsrain_engine.api has no 'open_scenes'"):
        api.open_scenes  # noqa: B018


def test_importing_it_loads_nothing_that_is_not_asked_for():
    heavy = ["numba", "moderngl", "matplotlib", "scipy", "torch", "cv2", "xarray", "av", "imgui_bundle"]
    script = f"import sys, gsrain_engine.api as api; print(sorted(set(sys.modules) & {set(heavy)}), api.Gaussians)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("[] <class 'gsrain_engine.scene.gaussians.Gaussians'>")
