"""Slow modules that few commands need are not loaded at start."""

import subprocess
import sys

import pytest

SCIPY_PARTS = ("interpolate", "ndimage", "optimize", "spatial", "stats")
SLOW = ("matplotlib", "onnxruntime", "torch", *(f"scipy.{part}" for part in SCIPY_PARTS))


@pytest.mark.parametrize(
    ("modules", "slow"),
    [
        ("app.main", ("numpy", "numba", "gsrain_engine.scene.scene")),
        ("ui.window", ("scipy", "numba")),
        ("ui.workspace", SLOW),
        ("app.render, app.drive", SLOW),
        ("app.scene, app.scene, app.evaluate.images", SLOW),
    ],
)
def test_a_start_does_not_load_what_it_may_never_need(modules, slow):
    code = f"import sys, {modules}; print(*(name for name in {slow!r} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    assert done.stdout.strip() == ""
