"""Masks as they stand in `scene.json`: packed bits, deflated, in base64."""

import base64
import binascii
import zlib
from collections.abc import Mapping

import msgspec
import numpy as np

from ..marks import UNMARKED, Marks
from ..mask import Mask


class MarksRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """`Marks` of a member, each as `text_of` writes it."""

    selected: str | None = None
    hidden: str | None = None
    deleted: str | None = None


def marks_record(marks: Marks) -> MarksRecord:
    """Plain values of marks; a mask that means no Gaussian is left out."""
    masks = {"selected": marks.selected, "hidden": marks.hidden, "deleted": marks.deleted}
    return MarksRecord(**{name: text_of(mask) for name, mask in masks.items() if mask})


def marks_of(record: MarksRecord, count: int, where: str) -> Marks:
    """Marks of a member of `count` Gaussians.

    Raises:
        ValueError: When a text is no mask of so many; `where` tells in which field of the file it stands.
    """
    if record == MarksRecord():
        return UNMARKED
    masks = {
        name: mask_of(text, count, f"{where}.{name}`")
        for name in ("selected", "hidden", "deleted")
        if (text := getattr(record, name)) is not None
    }
    return Marks(**masks)


def text_of(mask: Mask) -> str:
    """Write a mask: its words, little endian, as a zlib stream (RFC 1950) in base64."""
    return base64.b64encode(zlib.compress(mask.words.astype("<u4", copy=False).tobytes(), 1)).decode()


def mask_of(text: str, count: int, where: str) -> Mask:
    """Read a mask of `count` Gaussians.

    Raises:
        ValueError: When the text is damaged or a mask of another count; `where` tells in which field it stands.
    """
    expected = 4 * -(-count // 32)
    stream = zlib.decompressobj()
    try:
        # One byte more than is right tells what is too long from what fits, and keeps a lie from filling the memory.
        data = stream.decompress(base64.b64decode(text, validate=True), expected + 1)
    except (binascii.Error, zlib.error, ValueError) as error:
        raise ValueError(f"no mask can be read ({error}) - at {where}") from None
    if len(data) != expected:
        found = f"more than {expected}" if len(data) > expected else str(len(data))
        raise ValueError(f"a mask of {count} Gaussians takes {expected} bytes, this one has {found} - at {where}")
    if not stream.eof:
        raise ValueError(f"the mask is cut off - at {where}")
    words = np.frombuffer(data, "<u4").astype(np.uint32)
    if count % 32 and words[-1] >> np.uint32(count % 32):
        raise ValueError(f"the mask means Gaussians beyond the {count} that there are - at {where}")
    return Mask(count, words)


def selections_record(
    selections: Mapping[str, Mapping[str, Mask]], counts: Mapping[str, int]
) -> dict[str, dict[str, str]]:
    """Plain values of selection sets; what a set says of members that are gone or have other Gaussians is dropped."""
    return {
        name: {key: text_of(mask) for key, mask in masks.items() if counts.get(key) == mask.count}
        for name, masks in selections.items()
    }


def selections_of(record: Mapping[str, Mapping[str, str]], counts: Mapping[str, int]) -> dict[str, dict[str, Mask]]:
    """Selection sets of members whose numbers of Gaussians are `counts`, by their keys.

    Raises:
        ValueError: When a set names a member that is not there, or a mask does not fit.
    """
    sets: dict[str, dict[str, Mask]] = {}
    for name, masks in record.items():
        where = f"`$.selections[{name!r}]`"
        unknown = [key for key in masks if key not in counts]
        if unknown:
            raise ValueError(f"there is no layer or actor {unknown[0]!r} - at {where}")
        sets[name] = {key: mask_of(text, counts[key], where) for key, text in masks.items()}
    return sets
