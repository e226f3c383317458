"""Build hook of wheels that bring their kernels compiled: GSRAIN_COMPILED_KERNELS=1 pip wheel --no-build-isolation .

They are for the version of Python and the architecture that build them, and for any processor that has the features of
`gsrain_engine.compile_cache.BASELINES`; elsewhere, and with another version of Numba,
the first use compiles them.
"""

import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_COMPILE = "from gsrain_engine.editor.drawing.textures import compile_kernels; compile_kernels()"
_PROCESSOR = "from gsrain_engine.compile_cache import BASELINES, architecture; print(BASELINES[architecture()][0])"


class CompiledKernels(BuildHookInterface):
    """Compiles the kernels of pictures into a folder of the wheel, and names the wheel by what they are for."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the kernels, where the variable of the environment asks for them."""
        if version == "editable" or not os.environ.get("GSRAIN_COMPILED_KERNELS"):
            return
        self._folder = tempfile.TemporaryDirectory()
        command = [sys.executable, "-c"]
        found = subprocess.run([*command, _PROCESSOR], cwd=self.root, capture_output=True, text=True, check=True)
        environment = {
            **os.environ,
            "NUMBA_CACHE_DIR": self._folder.name,
            "NUMBA_CPU_NAME": found.stdout.strip(),
            "NUMBA_CPU_FEATURES": "",
        }
        subprocess.run([*command, _COMPILE], cwd=self.root, env=environment, check=True)
        for file in Path(self._folder.name).rglob("*"):
            if file.suffix in (".nbi", ".nbc", ".complete"):
                own = file.relative_to(self._folder.name)
                build_data["force_include"][str(file)] = f"gsrain_engine/compiled_kernels/{own.as_posix()}"
        build_data["pure_python"] = False
        system = sysconfig.get_platform().replace("-", "_").replace(".", "_").replace("linux_", "manylinux_2_28_")
        build_data["tag"] = f"cp{sys.version_info.major}{sys.version_info.minor}-none-{system}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the folder of the kernels, which the wheel has now."""
        if hasattr(self, "_folder"):
            self._folder.cleanup()
