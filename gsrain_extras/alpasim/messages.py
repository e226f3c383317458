"""Messages and calls of AlpaSim's sensor simulator, from their description.

The classes are built when the module is loaded: code that protoc generates fits only some versions of protobuf.
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

SERVICE = "nre.grpc.protos.sensorsim.SensorsimService"
API_VERSION = (0, 54, 0)
"""Version of AlpaSim's messages that the description is of."""

_DESCRIPTORS = Path(__file__).with_name("protos") / "descriptors.binpb"
_SENSORSIM = "alpasim_grpc/v0/sensorsim.proto"


class Call(NamedTuple):
    """One call of a service: classes of its request and its answer."""

    request: Any
    answer: Any


@cache
def _pool() -> Any:
    descriptor = import_module("google.protobuf.descriptor_pb2")
    pool = import_module("google.protobuf.descriptor_pool").DescriptorPool()
    for file in descriptor.FileDescriptorSet.FromString(_DESCRIPTORS.read_bytes()).file:
        pool.Add(file)
    return pool


@cache
def message(name: str) -> Any:
    """Class of a message by its full name, such as "common.Pose", or by its name in `sensorsim.proto`."""
    pool, factory = _pool(), import_module("google.protobuf.message_factory")
    full = name if "." in name and not name[0].isupper() else f"nre.grpc.protos.sensorsim.{name}"
    return factory.GetMessageClass(pool.FindMessageTypeByName(full))


@cache
def calls(service: str) -> dict[str, Call]:
    """Calls of a service by name."""
    factory = import_module("google.protobuf.message_factory")
    methods = _pool().FindServiceByName(service).methods
    return {
        each.name: Call(factory.GetMessageClass(each.input_type), factory.GetMessageClass(each.output_type))
        for each in methods
    }


def enum_name(enum: str, number: int) -> str:
    """Name of a number of an enumeration, such as "ShutterType"; the number itself if it has none."""
    found = _pool().FindEnumTypeByName(f"nre.grpc.protos.sensorsim.{enum}").values_by_number.get(number)
    return str(number) if found is None else found.name
