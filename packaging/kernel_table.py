"""Write gsrain_engine/kernel_table.txt: the kernels of pictures, in the order in which drawing them needs them."""

import sys
from typing import Any

from gsrain_engine.compile_cache import KERNEL_TABLE, has_kernels
from gsrain_engine.editor.drawing.textures import compile_kernels
from gsrain_engine.kernels import KernelCache, name_of


def text_of(kind: Any) -> str:
    """Return a type of Numba as a row of the table has it."""
    from numba import types  # after the engine, which chooses the place of its kernels

    match kind:
        case types.Array():
            steps = [":"] * kind.ndim
            if kind.layout in "CF":
                steps[-1 if kind.layout == "C" else 0] = "::1"
            text = f"{text_of(kind.dtype)}[{', '.join(steps)}]"
            return text if kind.mutable else f"const({text})"
        case types.NamedTuple() | types.NamedUniTuple():
            made = kind.instance_class
            name = f"{made.__module__.removeprefix('gsrain_engine.')}.{made.__qualname__}"
            return f"{name}({', '.join(map(text_of, kind.types))})"
        case types.BaseTuple():
            return f"({', '.join(map(text_of, kind.types))},)"
        case types.Boolean():
            return "boolean"
        case _:
            return str(kind)


def needed() -> list[str]:
    """Draw all kinds of pictures, and return the kernels that are called, in order."""
    rows, load = dict[str, None](), KernelCache.load_overload

    def note(self: KernelCache, sig: Any, target_context: Any) -> Any:
        rows[f"{name_of(self.function)}({', '.join(map(text_of, sig))})"] = None
        return load(self, sig, target_context)

    KernelCache.load_overload = note
    compile_kernels()
    return list(rows)


if __name__ == "__main__":
    if not has_kernels():  # else kernels that others call are among them
        sys.exit("Run make kernels first")
    KERNEL_TABLE.write_text("".join(f"{row}\n" for row in needed()))
