"""Recovery of truncated classic NetCDF files: counts complete records and corrects the header."""

import struct
from dataclasses import dataclass

_DIMENSIONS, _VARIABLES = 10, 11
_TYPE_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8}
_STREAMING = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class RecordLayout:
    """Layout of a classic NetCDF file's records, which interleave all record variables."""

    written: int
    """Number of records in the header."""
    start: int
    """First byte of the first record."""
    size: int
    """Bytes of a record."""
    fixed_end: int
    """First byte after the non-record data."""

    def whole(self, length: int) -> int:
        """Number of complete records in a file of this length; -1 if even the non-record data is incomplete."""
        if length < self.fixed_end or length < self.start:
            return -1
        return min(self.written, (length - self.start) // self.size) if self.size else self.written


def with_whole_records(data: bytes) -> tuple[bytes, int, int]:
    """Return the file with a header that counts only complete records, their number, and the expected number.

    Complete files, and files truncated before their first record, are returned unchanged. Raises `ValueError` if the
    header can't be read. Source: the NetCDF classic format specification (Unidata).
    """
    layout = record_layout(data)
    whole = layout.whole(len(data))
    if whole < 0 or whole == layout.written:
        return data, max(whole, 0), layout.written
    return data[:4] + struct.pack(">I", whole) + data[8:], whole, layout.written


def record_layout(data: bytes) -> RecordLayout:
    """Read the header; raises `ValueError` if it is truncated or damaged."""
    try:
        return _NetcdfHeader(data).layout()
    except (struct.error, KeyError, IndexError, OverflowError):
        raise ValueError("its header is cut off or damaged") from None


class _NetcdfHeader:
    def __init__(self, data: bytes):
        self.data = data
        self.at = 4
        self.offset_format = ">Q" if data[3] == 2 else ">I"

    def layout(self) -> RecordLayout:
        written = self.number()
        lengths = [(self.skip_name(), self.number())[1] for _ in range(self.entries(_DIMENSIONS))]
        self.skip_attributes()
        start, end, size, fixed_end, recorded = 2**63, 0, 0, 0, 0
        sizes: list[int] = []
        for _ in range(self.entries(_VARIABLES)):
            self.skip_name()
            dimensions = [self.number() for _ in range(self.number())]
            self.skip_attributes()
            item = _TYPE_SIZES[self.number()]
            self.number()  # vsize is wrong for large variables, so it is computed from the dimensions
            begin = self.number(self.offset_format)
            per_record = bool(dimensions) and lengths[dimensions[0]] == 0
            for dimension in dimensions[1:] if per_record else dimensions:
                item *= lengths[dimension]
            if per_record:
                recorded += 1
                sizes.append(item)
                start = min(start, begin)
            else:
                fixed_end = max(fixed_end, begin + item)
        # A lone record variable is not padded to four bytes.
        size = sizes[0] if recorded == 1 else sum(-(-each // 4) * 4 for each in sizes)
        end = max(self.at, fixed_end)
        return RecordLayout(0 if written == _STREAMING else written, start if recorded else end, size, end)

    def number(self, layout: str = ">I") -> int:
        (value,) = struct.unpack_from(layout, self.data, self.at)
        self.at += struct.calcsize(layout)
        return value

    def entries(self, tag: int) -> int:
        """Length of a list with this tag; an absent list is stored as two zeros."""
        found, length = self.number(), self.number()
        if found not in (0, tag) or length > len(self.data):
            raise KeyError(tag)
        return length

    def skip_name(self) -> None:
        length = self.number()
        self.at += -(-length // 4) * 4

    def skip_attributes(self) -> None:
        for _ in range(self.entries(12)):
            self.skip_name()
            size = _TYPE_SIZES[self.number()] * self.number()
            self.at += -(-size // 4) * 4
