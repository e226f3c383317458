"""Roll-outs as files: read back whole, and refused with a word where something is missing."""

import msgspec
import pytest

from gsrain_engine.simulation.rollout_io import read_rollout, write_rollout
from simulation.small_drive import driven, lead, scene_with_box


@pytest.fixture(scope="module")
def rollout():
    return driven({"road_users": [lead(ahead_m=20.0)], "duration_s": 1.0}, scene_with_box())


@pytest.fixture
def file(rollout, tmp_path):
    write_rollout(tmp_path / "run.jsonl", rollout)
    return tmp_path / "run.jsonl"


def test_what_is_written_is_read_back(file, rollout):
    assert read_rollout(file) == rollout


@pytest.mark.parametrize(
    ("torn", "words"),
    [
        (lambda lines: lines[:-1], "run.jsonl: a torn roll-out: its first line says 5 moments, 4 follow"),
        (lambda lines: [*lines[:2], *lines[3:]], "says 5 moments, 4 follow"),
        (lambda lines: [*lines[:-1], lines[-1][:40]], "run.jsonl: line 6: "),
        (lambda lines: lines[:1], "a roll-out of no moment"),
        (lambda lines: [], "not a roll-out"),
        (lambda lines: [lines[0].replace(b'"version":1', b'"version":2'), *lines[1:]], "a roll-out of version 2"),
        (lambda lines: [lines[0].replace(b'"lead":{', b'"other":{'), *lines[1:]], "road user 'lead' is not among"),
    ],
)
def test_what_is_torn_or_not_ours_is_refused(file, torn, words):
    file.write_bytes(b"\n".join(torn(file.read_bytes().splitlines())) + b"\n")
    with pytest.raises(ValueError, match=words):
        read_rollout(file)


def test_files_that_do_not_say_how_many_moments_there_are_can_be_read(file, rollout):
    first, *rest = file.read_bytes().splitlines()
    header = msgspec.json.decode(first)
    del header["moments"]
    file.write_bytes(b"\n".join([msgspec.json.encode(header), *rest]))
    assert read_rollout(file) == rollout
