"""Messages of gRPC's health check.

The classes are built when they are asked for: code that protoc generates fits only some versions of protobuf.
"""

from functools import cache
from importlib import import_module
from typing import Any

_PACKAGE = "grpc.health.v1"
HEALTH_SERVICE = f"{_PACKAGE}.Health"


@cache
def health_messages() -> tuple[Any, Any]:
    """Classes of the request and the answer of the call Check (grpc/health/v1/health.proto), without streams."""
    descriptor, factory = (import_module(f"google.protobuf.{name}") for name in ("descriptor_pb2", "message_factory"))
    pool = import_module("google.protobuf.descriptor_pool").DescriptorPool()
    file = descriptor.FileDescriptorProto(name="health.proto", package=_PACKAGE, syntax="proto3")
    file.message_type.add(name="HealthCheckRequest").field.add(name="service", number=1, label=1, type=9)
    answer = file.message_type.add(name="HealthCheckResponse")
    statuses = answer.enum_type.add(name="ServingStatus")
    for number, name in enumerate(("UNKNOWN", "SERVING", "NOT_SERVING", "SERVICE_UNKNOWN")):
        statuses.value.add(name=name, number=number)
    status = f".{_PACKAGE}.HealthCheckResponse.ServingStatus"
    answer.field.add(name="status", number=1, label=1, type=14, type_name=status)
    pool.Add(file)
    found = (pool.FindMessageTypeByName(f"{_PACKAGE}.HealthCheck{kind}") for kind in ("Request", "Response"))
    asked, answered = map(factory.GetMessageClass, found)
    return asked, answered
