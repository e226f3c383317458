from pathlib import Path

import pytest

from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.io.records import masked_crc32c, records_in
from tfrecord_framing import framed


def test_the_checksum_is_that_of_the_standard() -> None:
    # RFC 3720, B.4: CRC-32C of 32 zeros and of 32 ones; and the usual check value of "123456789".
    for content, crc in ((bytes(32), 0x8A9136AA), (b"\xff" * 32, 0x62A8AB43), (b"123456789", 0xE3069283)):
        masked = (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF
        assert masked_crc32c(content) == masked


def test_finds_records_and_reads_them_again(tmp_path: Path) -> None:
    file = tmp_path / "some.tfrecord"
    contents = [b"one", b"", bytes(range(256)) * 40]
    file.write_bytes(b"".join(framed(each) for each in contents))
    found = list(records_in(file))
    assert [content for _, content in found] == contents
    assert [record.read() for record, _ in found] == contents


def test_every_damage_is_named(tmp_path: Path) -> None:
    whole = framed(b"first record") + framed(b"second")
    file = tmp_path / "some.tfrecord"
    for place in range(len(whole)):
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 16]) + whole[place + 1 :])
        with pytest.raises(CaptureError, match=r"some\.tfrecord"):
            list(records_in(file))
    for length in range(1, len(whole)):
        if length == len(framed(b"first record")):
            continue
        file.write_bytes(whole[:length])
        with pytest.raises(CaptureError, match="cut off"):
            list(records_in(file))
