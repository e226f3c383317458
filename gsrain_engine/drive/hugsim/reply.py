"""What a HUGSIM client answers: points of a plan, or nothing."""

import numpy as np
from jaxtyping import Float64

from gsrain_engine.untrusted.printable import printable

from ..agents.client_error import ClientError
from ..agents.plan_points import plan_points
from .plain_unpickling import read_plain_pickle

MOST_BYTES = 1 << 20
"""A plan of six points is 200 bytes."""


def read_reply(data: bytes) -> Float64[np.ndarray, "n 2"] | None:
    """Return a plan's points (x right, y forward, metres, 0.5 s apart), none where the client gives up.

    Arrays of any numbers and lists of pairs are taken. Raises ClientError for anything else; nothing in it is run.
    """
    try:
        value = read_plain_pickle(data)
    except ValueError as problem:
        raise ClientError(f"the client sent {len(data)} bytes that can't be read: {printable(problem)}") from None
    return None if value is None else plan_points(value, "the client")
