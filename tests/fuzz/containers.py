"""Damage inside of containers whose checksums would stop it at the door: gzip, zip and TFRecord."""

import gzip
import io
import zipfile
import zlib
from collections.abc import Callable
from random import Random

from .mutations import damaged_bytes

Damage = Callable[[bytes, Random], bytes]
"""Makes another file of a file, as the generator decides."""


def inside_gzip(inner: Damage = damaged_bytes) -> Damage:
    """Damage what is packed, and a quarter of the time the stream itself."""

    def damage(data: bytes, chance: Random) -> bytes:
        if chance.random() < 0.25:
            return damaged_bytes(data, chance)
        return gzip.compress(inner(gzip.decompress(data), chance), 1, mtime=0)

    return damage


def inside_zip(of_member: Callable[[str], Damage]) -> Damage:
    """Damage a member, drop, double or rename one, and a quarter of the time the archive itself."""

    def damage(data: bytes, chance: Random) -> bytes:
        if chance.random() < 0.25:
            return damaged_bytes(data, chance)
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(name, archive.read(name)) for name in archive.namelist()]
        k = chance.randrange(len(members))
        name, content = members[k]
        match chance.randrange(8):
            case 0:
                del members[k]
            case 1:
                members[k] = chance.choice((f"../{name}", f"/{name}", name.upper(), "x" * 70_000)), content
            case _:
                members[k] = name, of_member(name)(content, chance)
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w", chance.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
            for name, content in members:
                archive.writestr(zipfile.ZipInfo(name[:60_000]), content)
        return file.getvalue()

    return damage


def inside_records(framed: Callable[[bytes], bytes]) -> Damage:
    """Damage the content of one record of a TFRecord file and give it its checksum again, or damage the file."""

    def damage(data: bytes, chance: Random) -> bytes:
        if chance.random() < 0.2:
            return damaged_bytes(data, chance)
        contents: list[bytes] = []
        place = 0
        while place < len(data):
            size = int.from_bytes(data[place : place + 8], "little")
            contents.append(data[place + 12 : place + 12 + size])
            place += 16 + size
        k = chance.randrange(len(contents))
        contents[k] = damaged_bytes(contents[k], chance)
        return b"".join(map(framed, contents))

    return damage


def inside_zlib(data: bytes, chance: Random) -> bytes:
    """Damage what a zlib stream packs."""
    return zlib.compress(damaged_bytes(zlib.decompress(data), chance))
