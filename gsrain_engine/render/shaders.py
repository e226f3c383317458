"""GLSL sources: includes, switches, and compile errors that name the shader's own file and line."""

import re
from importlib import resources

import moderngl

_INCLUDE = re.compile(r'^\s*#include "(\w+\.glsl)"\s*$')
# Mesa "0:7(3): error", NVIDIA "0(7) : error", others "ERROR: 0:7: ...".
_LINE_IN_ERROR = re.compile(r"^(?:ERROR: )?0[:(](\d+)\)?", re.MULTILINE)


class ShaderError(RuntimeError):
    """A shader that does not compile: the driver's words with our files and lines."""


def load_program(context: moderngl.Context, *names: str, switches: tuple[str, ...] = ()) -> moderngl.Program:
    """Compile a vertex and a fragment shader (`name.vert`, `name.frag`) of the package `shaders`."""
    vertex, fragment = (_Source(name, switches) for name in names)
    try:
        return context.program(vertex_shader=vertex.text, fragment_shader=fragment.text)
    except moderngl.Error as error:
        source = vertex if "vertex_shader" in str(error) else fragment
        raise ShaderError(source.explain(str(error))) from None


def load_compute_shader(context: moderngl.Context, name: str) -> moderngl.ComputeShader:
    """Compile a compute shader (`name.comp`) of the package `shaders`."""
    source = _Source(name, ())
    try:
        return context.compute_shader(source.text)
    except moderngl.Error as error:
        raise ShaderError(source.explain(str(error))) from None


class _Source:
    """The text of a shader after its includes, and where each line came from."""

    def __init__(self, name: str, switches: tuple[str, ...]) -> None:
        self.name = name
        self.origins: list[tuple[str, int]] = []
        lines: list[str] = []
        for number, line in enumerate(_read(name), start=1):
            include = _INCLUDE.match(line)
            if include:
                for inner_number, inner in enumerate(_read(include[1]), start=1):
                    lines.append(inner)
                    self.origins.append((include[1], inner_number))
                continue
            lines.append(line)
            self.origins.append((name, number))
            if line.startswith("#version"):
                for switch in switches:
                    lines.append(f"#define {switch}")
                    self.origins.append((name, number))
        self.text = "\n".join(lines) + "\n"

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
    return resources.files("shaders").joinpath(name).read_text(encoding="utf-8").splitlines()
