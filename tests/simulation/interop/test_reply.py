"""Valid replies of clients, and rejected ones."""

import os
import pickle
import struct
import subprocess

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.simulation.agents.http import ClientError
from gsrain_engine.simulation.interop.hugsim_protocol import read_reply

PLAN = np.arange(12.0).reshape(6, 2)
PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)
WAYS = {
    "float64": PLAN, "float32": PLAN.astype("f4"), "int": PLAN.astype(int), "big end first": PLAN.astype(">f8"),
    "columns first": np.asfortranarray(PLAN), "list of lists": PLAN.tolist(), "rows": list(PLAN),
    "tuples": tuple(map(tuple, PLAN.tolist())), "scalars": [[np.float32(x), np.float64(y)] for x, y in PLAN],
}  # fmt: skip


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("way", WAYS)
def test_plans_are_read_in_every_way(way, protocol):
    points = read_reply(pickle.dumps(WAYS[way], protocol))
    assert points.dtype == np.float64
    np.testing.assert_array_equal(points, PLAN)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_none_is_none(protocol):
    assert read_reply(pickle.dumps(None, protocol)) is None


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_tensors_are_read_without_torch(protocol):
    """VAD's client sends one: np.cumsum of a tensor is a tensor."""
    torch = pytest.importorskip("torch")
    tensor = torch.from_numpy(PLAN)
    ways = [
        tensor,
        tensor.float(),
        tensor.half(),
        tensor.long(),
        tensor.T.contiguous().T,
        torch.cat([tensor, tensor])[6:],
    ]
    for way in [*ways, torch.nn.Parameter(tensor).detach(), np.cumsum(np.diff(tensor, axis=0, prepend=0), axis=0)]:
        np.testing.assert_array_equal(read_reply(pickle.dumps(way, protocol)), PLAN)


# A tensor of 2 x 2 float32 as PyTorch pickles it, by hand: what is read does not need it.
STORAGE = (
    b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.\x80\x02}q\x00."
    b"\x80\x02(X\x07\x00\x00\x00storageq\x00ctorch\nFloatStorage\nq\x01X\x01\x00\x00\x000q\x02X\x03\x00\x00\x00cpuq\x03"
    b"K\x04Ntq\x04Q.\x80\x02]q\x00X\x01\x00\x00\x000q\x01a." + struct.pack("<q4f", 4, 1.0, 2.0, 3.0, 4.0)
)


def tensor_pickle(storage=STORAGE, first=0, shape=(2, 2), steps=(2, 1)):
    numbers = [b"K" + bytes([each]) for each in (first, *shape, *steps)]
    return (
        b"\x80\x03ctorch._utils\n_rebuild_tensor_v2\n(ctorch.storage\n_load_from_bytes\nB"
        + struct.pack("<I", len(storage)) + storage + b"\x85R" + numbers[0]
        + numbers[1] + numbers[2] + b"\x86" + numbers[3] + numbers[4] + b"\x86"
        + b"\x89ccollections\nOrderedDict\n)RtR."
    )  # fmt: skip


def test_a_tensor_is_read_by_its_steps():
    np.testing.assert_array_equal(read_reply(tensor_pickle()), [[1, 2], [3, 4]])
    np.testing.assert_array_equal(read_reply(tensor_pickle(steps=(1, 2))), [[1, 3], [2, 4]])
    np.testing.assert_array_equal(read_reply(tensor_pickle(first=2, shape=(1, 2))), [[3, 4]])


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (tensor_pickle(first=1), r"shape \(2, 2\) in a storage of 4"),
        (tensor_pickle(steps=(200, 1)), r"shape \(2, 2\) in a storage of 4"),
        (tensor_pickle(STORAGE[:-4]), "a storage of 4 numbers in 12 bytes"),
        (tensor_pickle(STORAGE[:-24]), "can't be read"),
        (
            tensor_pickle(STORAGE.replace(b"torch\nFloatStorage", b"os\nsystem")),
            "a tensor of os system, not of numbers",
        ),
        (tensor_pickle(b""), "can't be read"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_tensors_that_lie_are_refused(data, why):
    with pytest.raises(ClientError, match=why):
        read_reply(data)


def test_old_and_new_names_are_read():
    new = pickle.dumps(PLAN, 4)
    assert b"numpy._core.multiarray" in new
    # Lengths stand before names in the stream: the old name is one character shorter, its frame too.
    old = pickle.dumps(PLAN, 2).replace(b"numpy._core", b"numpy.core")
    assert b"numpy.core.multiarray" in old
    np.testing.assert_array_equal(read_reply(old), PLAN)


def test_numpy_1_writes_what_is_read():
    python = os.environ.get("GSRAIN_OLD_NUMPY_PYTHON")
    if python is None:
        pytest.skip("no Python with NumPy 1 (set GSRAIN_OLD_NUMPY_PYTHON)")
    code = "import pickle, sys, numpy as np; sys.stdout.buffer.write(pickle.dumps(np.arange(12.).reshape(6, 2)))"
    ran = subprocess.run([python, "-c", code], capture_output=True, check=True)
    np.testing.assert_array_equal(read_reply(ran.stdout), PLAN)


class Runs:
    """Makes a folder when it is simply unpickled."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return os.mkdir, (self.path,)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_code_does_not_run(tmp_path, protocol):
    with pytest.raises(ClientError, match=r"names (posix|nt)\.mkdir, which is not let in"):
        read_reply(pickle.dumps([PLAN, Runs(tmp_path / "ran")], protocol))
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    "call",
    [
        b"cbuiltins\neval\n(X\x03\x00\x00\x001+1tR.",
        b"cos\nsystem\n(X\x04\x00\x00\x00truetR.",
        b"cnumpy\nload\n(X\x01\x00\x00\x00xtR.",
        b"cnumpy.core.multiarray\nfromfile\n)R.",
        b"(S'x'\nios\nsystem\n.",
        b"cnumpy\nndarray\n}X\x01\x00\x00\x00aI1\nsb.",
        b"\x80\x02\x82\x01.",
        b"Pid\n.",
    ],
)
def test_names_and_tricks_are_refused(call):
    with pytest.raises(ClientError, match="can't be read"):
        read_reply(call)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "0 bytes that can't be read"),
        (b"\x00 nothing", "can't be read"),
        (pickle.dumps(PLAN)[:-20], "can't be read"),
        (pickle.dumps(PLAN) + b"x", "something follows after its end"),
        (b"\x80\x04r\xff\xff\xff\xff.", "remembers too much"),
        (b"\x80\x05\x96\xff\xff\xff\xff\xff\x00\x00\x00.", "can't be read"),
        (b"cnumpy\nndarray\n((I100000000000\nI2\ntS'<f8'\ntR.", r"array of shape \(100000000000, 2\)"),
        (b"cnumpy\nndarray\n((I3\nI2\ntS'<f8'\ntR.", r"array of shape \(3, 2\) in 0 bytes"),
        (pickle.dumps(PLAN.astype("S8")), "not of numbers"),
        (pickle.dumps("Done"), "sent a str for a plan"),
        (pickle.dumps({"plan": 1}), "does EMPTY_DICT, which no plan needs"),
        (pickle.dumps({1, 2}), "does EMPTY_SET, which no plan needs"),
        (b"})" + b"\x85" * 300_000 + b"Ns.", "does EMPTY_DICT"),  # hashing that key would end the program
        (b"cnumpy\ndtype\n(" + b"(l" + b"p0\n(g0\ng0\ng0\ng0\nl" * 60 + b"tR.", "where a word belongs"),
        (pickle.dumps(np.float64(2)), "sent a float for a plan"),
        (pickle.dumps(PLAN.T), r"shape \(2, 6\), not \(N, 2\)"),
        (pickle.dumps(PLAN[None]), r"shape \(1, 6, 2\)"),
        (pickle.dumps(PLAN[:0]), r"shape \(0, 2\)"),
        (pickle.dumps([]), r"shape \(0, 2\)"),
        (pickle.dumps(np.zeros((1001, 2))), r"shape \(1001, 2\)"),
        (pickle.dumps([[1.0, 2.0], [3.0]]), "not of pairs"),
        (pickle.dumps([[1.0, "2"]]), "not of pairs"),
        (pickle.dumps([[10**400, 1]]), "not of pairs"),
        (pickle.dumps(PLAN * np.nan), "not finite"),
        (pickle.dumps([[1.0, float("inf")]]), "not"),
        (pickle.dumps(1e5 * PLAN), "farther than 10 km"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_no_plan_is_said(data, why):
    with pytest.raises(ClientError, match=why):
        read_reply(data)


WHOLE = [tensor_pickle(), *(pickle.dumps(PLAN, protocol) for protocol in PROTOCOLS)]


@given(place=st.integers(0, 400), byte=st.integers(0, 255), whole=st.sampled_from(WHOLE))
def test_damage_is_read_or_refused_and_nothing_else(place, byte, whole):
    data = bytearray(whole)
    data[place % len(data)] = byte
    try:
        points = read_reply(bytes(data))
    except ClientError:
        return
    assert points is None or (points.shape[1] == 2 and np.isfinite(points).all())


@given(st.binary(max_size=60))
def test_noise_is_read_or_refused_and_nothing_else(data):
    try:
        assert read_reply(data) is None
    except ClientError as problem:
        assert str(problem)
