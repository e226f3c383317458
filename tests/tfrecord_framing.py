"""Writes records as TFRecord frames them."""

import struct

from gsrain_engine.datasets.io.records import masked_crc32c


def framed(content: bytes) -> bytes:
    head = struct.pack("<Q", len(content))
    sums = [struct.pack("<I", masked_crc32c(part)) for part in (head, content)]
    return head + sums[0] + content + sums[1]
