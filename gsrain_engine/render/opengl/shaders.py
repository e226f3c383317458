"""GLSL shaders: includes, macros, compile errors with file and line of the source, and GPU timers."""

import re
import time
from collections import defaultdict
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from typing import Any

import moderngl

from ...presets import shipped_path
from .context import is_software

_LONGEST_DISPATCH = 1 << 15
"""Workgroups along one axis, half of the limit guaranteed by OpenGL."""

_INCLUDE = re.compile(r'^\s*#include "(\w+\.glsl)"\s*$')

# Mesa "0:7(3): error", NVIDIA "0(7) : error", others "ERROR: 0:7: ...".
_LINE_IN_ERROR = re.compile(r"^(?:ERROR: )?0[:(](\d+)\)?", re.MULTILINE)


class ShaderError(RuntimeError):
    """Raised if a shader does not compile; contains the driver's message with source files and lines."""


Switches = Mapping[str, int]  # macros of a shader, by name


def load_program(context: moderngl.Context, *names: str, switches: Switches | None = None) -> moderngl.Program:
    """Compile a vertex and a fragment shader (`name.vert`, `name.frag`) of the folder `shaders`."""
    vertex, fragment = (ShaderSource(name, switches or {}) for name in names)
    try:
        return context.program(vertex_shader=vertex.text, fragment_shader=fragment.text)
    except moderngl.Error as error:
        source = vertex if "vertex_shader" in str(error) else fragment
        raise ShaderError(source.explain(str(error))) from None


class ComputeShader:
    """Compiled compute shader; writes only the uniforms that changed, since a GPU waits for each call of a frame."""

    def __init__(self, shader: moderngl.ComputeShader) -> None:
        self._shader = shader
        self._written: dict[str, Any] = {}

    def run(self, columns: int = 1, rows: int = 1) -> None:
        """Run a number of workgroups."""
        self._shader.run(columns, rows)

    def run_all(self, groups: int) -> None:
        """Run any number of workgroups, over two axes: gl_WorkGroupID.x + gl_WorkGroupID.y * gl_NumWorkGroups.x.

        Where only the GPU knows how many are needed, more are run, which return at once: NVIDIA's driver takes 40 us
        for an indirect dispatch.
        """
        self._shader.run(min(groups, _LONGEST_DISPATCH), -(-groups // _LONGEST_DISPATCH))

    def set(self, **values: Any) -> None:
        """Set uniforms to numbers or tuples."""
        for name, value in values.items():
            if self._written.get(name) != value:
                self._shader[name] = self._written[name] = value


def load_compute_shader(context: moderngl.Context, name: str, switches: Switches | None = None) -> ComputeShader:
    """Compile a compute shader (`name.comp`) of the folder `shaders`."""
    source = ShaderSource(name, switches or {})
    try:
        return ComputeShader(context.compute_shader(source.text))
    except moderngl.Error as error:
        raise ShaderError(source.explain(str(error))) from None


class ShaderVariants:
    """Compute shader compiled once for each set of switches; call it with those."""

    def __init__(self, context: moderngl.Context, name: str) -> None:
        self._context, self._name = context, name
        self._compiled: dict[tuple[tuple[str, int], ...], ComputeShader] = {}

    def __call__(self, switches: Switches) -> ComputeShader:
        key = tuple(switches.items())
        if key not in self._compiled:
            self._compiled[key] = load_compute_shader(self._context, self._name, switches)
        return self._compiled[key]


class ShaderSource:
    """Text of a shader with expanded includes, and the origin of each line."""

    def __init__(self, name: str, switches: Switches) -> None:
        self.name = name
        self.origins: list[tuple[str, int]] = []
        self._lines: list[str] = []
        self._switches = switches
        self._take_in(name)
        self.text = "\n".join(self._lines) + "\n"

    def _take_in(self, name: str) -> None:
        for number, line in enumerate(read_shader(name), start=1):
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
            return "{}:{}".format(*self.origins[line - 1]) if 1 <= line <= len(self.origins) else match[0]

        return f"{self.name} does not compile:\n" + _LINE_IN_ERROR.sub(place, message)


def read_shader(name: str) -> list[str]:
    """Read the lines of a shader file of the package."""
    return (shipped_path("shaders") / name).read_text(encoding="utf-8").splitlines()


class GpuTimers:
    """One timer query per stage; `collect` reads them after the frame has finished, to avoid stalls.

    A software rasterizer's queries are meaningless: there each stage is awaited and its wall time used, which costs
    little since the same processor does the work.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._is_software = is_software(context)
        self._free: list[moderngl.Query] = []
        self._running: list[tuple[str, moderngl.Query]] = []
        self._stages_ms: dict[str, float] = defaultdict(float)
        self._is_inside = False

    @contextmanager
    def stage(self, name: str) -> Generator[None]:
        """Measure the OpenGL work issued within the block; times of the same name are summed.

        OpenGL runs one timer query at a time: within a stage, other stages are part of it and not measured themselves.
        """
        if self._is_inside:
            yield
            return
        self._is_inside = True
        try:
            with self._measured(name):
                yield
        finally:
            self._is_inside = False

    @contextmanager
    def _measured(self, name: str) -> Generator[None]:
        if self._is_software:
            start = time.perf_counter()
            yield
            self._context.finish()
            self._stages_ms[name] += 1000 * (time.perf_counter() - start)
            return
        query = self._free.pop() if self._free else self._context.query(time=True)
        with query:
            yield
        self._running.append((name, query))

    def collect(self) -> dict[str, float]:
        """Milliseconds by stage since the last call; waits for the GPU if necessary."""
        for name, query in self._running:
            self._stages_ms[name] += query.elapsed / 1e6
            self._free.append(query)
        self._running.clear()
        collected = dict(self._stages_ms)
        self._stages_ms.clear()
        return collected
