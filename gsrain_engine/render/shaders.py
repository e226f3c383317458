"""GLSL sources: includes, switches, and compile errors that name the shader's own file and line."""

import re
from collections.abc import Mapping

import moderngl

from gsrain_engine.shipped_configs import shipped_folder

_INCLUDE = re.compile(r'^\s*#include "(\w+\.glsl)"\s*$')
# Mesa "0:7(3): error", NVIDIA "0(7) : error", others "ERROR: 0:7: ...".
_LINE_IN_ERROR = re.compile(r"^(?:ERROR: )?0[:(](\d+)\)?", re.MULTILINE)


class ShaderError(RuntimeError):
    """A shader that does not compile: the driver's words with our files and lines."""


Switches = Mapping[str, int]
"""Macros that a shader is compiled with, by name."""


def load_program(context: moderngl.Context, *names: str, switches: Switches | None = None) -> moderngl.Program:
    """Compile a vertex and a fragment shader (`name.vert`, `name.frag`) of the package `shaders`."""
    vertex, fragment = (_Source(name, switches or {}) for name in names)
    try:
        return context.program(vertex_shader=vertex.text, fragment_shader=fragment.text)
    except moderngl.Error as error:
        source = vertex if "vertex_shader" in str(error) else fragment
        raise ShaderError(source.explain(str(error))) from None


def load_compute_shader(
    context: moderngl.Context, name: str, switches: Switches | None = None
) -> moderngl.ComputeShader:
    """Compile a compute shader (`name.comp`) of the package `shaders`."""
    source = _Source(name, switches or {})
    try:
        return context.compute_shader(source.text)
    except moderngl.Error as error:
        raise ShaderError(source.explain(str(error))) from None


class _Source:
    """The text of a shader after its includes, and where each line came from."""

    def __init__(self, name: str, switches: Switches) -> None:
        self.name = name
        self.origins: list[tuple[str, int]] = []
        self._lines: list[str] = []
        self._switches = switches
        self._take_in(name)
        self.text = "\n".join(self._lines) + "\n"

    def _take_in(self, name: str) -> None:
        for number, line in enumerate(_read(name), start=1):
            include = _INCLUDE.match(line)
            if include:
                self._take_in(include[1])
                continue
            added = [line]
            if line.startswith("#version"):
                added += [f"#define {switch} {value}" for switch, value in self._switches.items()]
            self._lines += added
            self.origins += [(name, number)] * len(added)

    def explain(self, message: str) -> str:
        """Replace line numbers of the expanded text by file names and lines."""

        def place(match: re.Match[str]) -> str:
            line = int(match[1])
            if not 1 <= line <= len(self.origins):
                return match[0]
            file, number = self.origins[line - 1]
            return f"{file}:{number}"

        return f"{self.name} does not compile:\n" + _LINE_IN_ERROR.sub(place, message)


def _read(name: str) -> list[str]:
    return (shipped_folder("shaders") / name).read_text(encoding="utf-8").splitlines()
