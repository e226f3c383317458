"""Pretend CUDA device on torch's CPU: tensors that say "cuda:0", and a record of each operation that would synchronize.

A tensor of the device holds a CPU tensor, so that all numbers are real. Torch's dispatcher reports every operation on
it. Operations that make the processor wait for a GPU are recorded with the line of the project that calls them: results
whose value or shape the processor needs, copies to the processor, and copies from memory that is not pinned.
"""

import contextlib
import sys
import traceback
from collections.abc import Generator
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_map

from repository import REPOSITORY

_WAITS = {
    "_local_scalar_dense", "nonzero", "masked_select", "is_nonzero", "equal", "bincount", "unique_dim", "_unique2",
    "unique_consecutive", "repeat_interleave", "linalg_inv_ex", "_linalg_check_errors", "_linalg_solve_ex", "histc",
}  # fmt: skip
"""Operations whose result has a value or a shape that the processor needs."""

_NO_KERNELS = {
    "view", "_unsafe_view", "select", "slice", "permute", "transpose", "t", "unsqueeze", "squeeze", "expand", "detach",
    "alias", "unbind", "split", "as_strided", "is_pinned", "_reshape_alias", "empty", "empty_like", "new_empty",
    "split_with_sizes", "lift_fresh", "_record_function_enter_new", "_record_function_exit",
}  # fmt: skip
"""Operations that start no kernel on a GPU."""


class DeviceTensor(torch.Tensor):
    """Tensor that says it is on "cuda:0" and holds its numbers in a CPU tensor."""

    @staticmethod
    def __new__(cls, inner: torch.Tensor) -> "DeviceTensor":
        # Autograd keeps a queue for each kind of device; that of "meta" is the calling thread.
        made = torch.Tensor._make_wrapper_subclass(
            cls, inner.size(), strides=inner.stride(), storage_offset=inner.storage_offset(), dtype=inner.dtype,
            device="meta",
        )  # fmt: skip
        made.inner = inner
        return made

    device = property(lambda self: torch.device("cuda", 0))
    is_cuda = property(lambda self: True)
    __repr__ = object.__repr__

    @classmethod
    def __torch_dispatch__(cls, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _done(function, args, kwargs or {}, None)

    def cpu(self) -> torch.Tensor:
        return self.to("cpu")

    def tolist(self) -> list[Any]:
        return self.cpu().tolist()

    def numpy(self) -> np.ndarray:
        raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu() first")


class PretendDevice(TorchDispatchMode):
    """Runs operations for the pretend device, and records those that would synchronize while `is_recording`."""

    def __init__(self) -> None:
        super().__init__()
        self.is_recording = False
        self.synchronizations: list[str] = []
        """Operation, and file, line and source line of the project that called it, of each synchronization."""
        self.kernels = 0
        """Number of operations that would start a kernel or a copy."""

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        return False  # else torch imports its compiler, which takes seconds

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _done(function, args, kwargs or {}, self)

    @contextlib.contextmanager
    def recording(self, records: bool = True) -> Generator[None]:
        """Record synchronizations while the block runs, or leave them out, as those within gsplat itself."""
        before, self.is_recording = self.is_recording, records
        yield
        self.is_recording = before

    def note(self, operation: str) -> None:
        if self.is_recording:
            self.synchronizations.append(f"{operation}: {_caller()}")


def _done(function: Any, args: Any, kwargs: dict[str, Any], mode: PretendDevice | None) -> Any:
    """Run an operation on the CPU tensors; its tensors are on the pretend device if an argument is, or `device` is."""
    found: list[bool] = []

    def inner(value: Any) -> Any:
        if isinstance(value, DeviceTensor):
            found.append(True)
            return value.inner
        return value

    name = function.overloadpacket.__name__
    own, named = tree_map(inner, args), tree_map(inner, kwargs)
    device = named.get("device")
    was_on_device = bool(found)
    on_device = was_on_device if device is None else torch.device(device).type in ("cuda", "meta")
    if device is not None:
        named["device"] = torch.device("cpu")
    if mode is not None and (was_on_device or on_device):
        if mode.is_recording:
            mode.kernels += name.rstrip("_") not in _NO_KERNELS and name not in _NO_KERNELS
        if reason := _synchronizes(name, own, named, was_on_device, on_device, args):
            mode.note(reason)
    if name == "_to_copy":
        named.pop("non_blocking", None)
        named.pop("pin_memory", None)
    result = function(*own, **named)
    if not on_device:
        return result
    if name.endswith("_") and not name.endswith("__") and isinstance(args[0], DeviceTensor):
        return args[0]
    return tree_map(lambda each: DeviceTensor(each) if isinstance(each, torch.Tensor) else each, result)


def _synchronizes(
    name: str, args: Any, kwargs: dict[str, Any], was_on_device: bool, on_device: bool, outer: Any
) -> str | None:
    """Name the synchronization of an operation, None without one."""
    if name in _WAITS:
        return name
    if name in ("index", "index_put", "index_put_", "_index_put_impl_"):
        if any(each is not None and each.dtype in (torch.bool, torch.uint8) for each in args[1]):
            return f"{name} by a mask"
        if any(each is not None and not isinstance(each, DeviceTensor) for each in outer[1]):
            return f"{name} by indices of the processor"
    if name in ("_to_copy", "copy_"):
        if name == "copy_":
            was_on_device, on_device = isinstance(outer[1], DeviceTensor), isinstance(outer[0], DeviceTensor)
        if was_on_device and not on_device:
            return "copy to the processor"
        source = args[1] if name == "copy_" else args[0]
        is_scalar = name == "copy_" and source.ndim == 0
        is_free = getattr(source, "is_pretended_pinned", False) and kwargs.get("non_blocking", False)
        if on_device and not was_on_device and not is_free and not is_scalar:
            return "copy from the processor"
    return None


def _caller() -> str:
    """File, line and source line of the innermost frame in the project's own code."""
    for frame in reversed(traceback.extract_stack()):
        path = Path(frame.filename)
        if path.is_relative_to(REPOSITORY / "gsrain_engine"):
            return f"{path.relative_to(REPOSITORY)}:{frame.lineno} {frame.line}"
    return "backward pass, or a test"


class _Event:
    """Event on the device, each 2 ms after the one before."""

    _count = 0

    def __init__(self, enable_timing: bool = False) -> None:
        assert enable_timing
        self._at_ms = -1

    def record(self) -> None:
        _Event._count += 1
        self._at_ms = 2 * _Event._count

    def elapsed_time(self, after: "_Event") -> int:
        return after._at_ms - self._at_ms

    def synchronize(self) -> None:
        """Nothing is queued here."""


class _Generator(torch.Generator):
    """Random numbers of the CPU, for any device."""

    def __new__(cls, device: Any = None) -> "_Generator":
        return super().__new__(cls)


@contextlib.contextmanager
def pretend_device(monkeypatch: pytest.MonkeyPatch) -> Generator[PretendDevice]:
    """Use "cuda" as the pretend device, with the stand-in for gsplat, whose own synchronizations are not recorded."""
    from render import gsplat_stand_in

    mode, plain = PretendDevice(), {name: getattr(torch, name) for name in ("tensor", "as_tensor")}
    to = torch.Tensor.to

    def by_stand_in(name: str) -> Any:
        def call(*args: Any, **arguments: Any) -> Any:
            with mode.recording(False):
                return getattr(gsplat_stand_in, name)(*args, **arguments)

        return call

    def made(name: str) -> Any:
        def make(values: Any, *args: Any, device: Any = None, **kwargs: Any) -> Any:
            if device is None or torch.device(device).type != "cuda" or isinstance(values, DeviceTensor):
                return plain[name](values, *args, **kwargs)
            mode.note(f"torch.{name} of values of the processor")
            return DeviceTensor(plain[name](values, *args, **kwargs))

        return make

    def moved(self: torch.Tensor, *args: Any, non_blocking: bool = False, **kwargs: Any) -> torch.Tensor:
        target = args[0] if args else kwargs.get("device")
        if isinstance(self, DeviceTensor) or not isinstance(target, (str, torch.device)):
            return to(self, *args, non_blocking=non_blocking, **kwargs)
        if torch.device(target).type != "cuda":
            return to(self, *args, non_blocking=non_blocking, **kwargs)
        if not (non_blocking and getattr(self, "is_pretended_pinned", False)):
            mode.note("copy from the processor")
        mode.kernels += mode.is_recording
        return DeviceTensor(self.clone())

    def pinned(self: torch.Tensor) -> torch.Tensor:
        copy = self.clone()
        copy.is_pretended_pinned = True
        return copy

    monkeypatch.setattr(torch.cuda, "_lazy_init", lambda: None)
    monkeypatch.setattr(torch, "Generator", _Generator)
    monkeypatch.setattr(torch.Tensor, "pin_memory", pinned)
    monkeypatch.setattr(torch.Tensor, "to", moved)
    monkeypatch.setattr(torch.cuda, "Event", _Event)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (1 << 30, 1 << 30))
    monkeypatch.setattr(torch, "tensor", made("tensor"))
    monkeypatch.setattr(torch, "as_tensor", made("as_tensor"))
    gsplat = ModuleType("gsplat")
    gsplat.__spec__, gsplat.__path__ = ModuleSpec("gsplat", None), []
    for name in ("rasterization", "spherical_harmonics"):
        setattr(gsplat, name, by_stand_in(name))
    monkeypatch.setitem(sys.modules, "gsplat", gsplat)
    monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", SimpleNamespace(_C=object()))
    with mode:
        yield mode
