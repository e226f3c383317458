"""Pickles for HUGSIM's clients that any NumPy reads, and their replies: read in every form, or refused and not run."""

import os
import pickle
import pickletools

import numpy as np
import pytest

from gsrain_engine.simulation.agents.http import ClientError
from gsrain_engine.simulation.interop.hugsim_pickle import old_pickle
from gsrain_engine.simulation.interop.hugsim_protocol import read_reply

# Written


VALUE = {
    "image": np.arange(24, dtype=np.uint8).reshape(2, 4, 3), "turned": np.eye(4)[::-1].T, "empty": np.zeros((0, 2)),
    "depth": np.full((2, 2), 1.5, np.float32), "single": np.array(2.5), "float": np.float64(0.1), "int": np.int64(3),
    "bool": np.bool_(True), "nested": [(np.float32(0.5), "text", None)],
}  # fmt: skip


def test_values_come_back_writable_and_the_stream_names_numpy_and_nothing_inside_it():
    stream = bytes(old_pickle(VALUE))
    names = {argument for _, argument, _ in pickletools.genops(stream) if isinstance(argument, str)}
    assert {"numpy", "builtins"} <= names and not any(name.startswith("numpy.") for name in names)
    assert stream[:2] == b"\x80\x04" and stream == bytes(old_pickle(VALUE))
    back = pickle.loads(stream)
    for name in ("image", "turned", "empty", "depth", "single"):
        np.testing.assert_array_equal(back[name], VALUE[name])
        assert back[name].dtype == VALUE[name].dtype and back[name].flags.writeable
    assert [type(back[name]) for name in ("float", "int", "bool")] == [float, int, bool] and back["float"] == 0.1
    assert back["nested"] == [(0.5, "text", None)]
    with pytest.raises(TypeError, match="object"):
        old_pickle(np.array([object()]))


# Read

PLAN = np.arange(12.0).reshape(6, 2)
PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)
FORMS = {
    "float64": PLAN, "float32": PLAN.astype("f4"), "int": PLAN.astype(int), "big end first": PLAN.astype(">f8"),
    "columns first": np.asfortranarray(PLAN), "list of lists": PLAN.tolist(), "rows": list(PLAN),
    "tuples": tuple(map(tuple, PLAN.tolist())), "scalars": [[np.float32(x), np.float64(y)] for x, y in PLAN],
}  # fmt: skip


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_plans_are_read_in_every_form(protocol):
    for form, plan in FORMS.items():
        points = read_reply(pickle.dumps(plan, protocol))
        assert points.dtype == np.float64
        np.testing.assert_array_equal(points, PLAN, err_msg=form)
    assert read_reply(pickle.dumps(None, protocol)) is None
    # Lengths stand before names in the stream: the old name is one character shorter, its frame too.
    old = pickle.dumps(PLAN, 2).replace(b"numpy._core", b"numpy.core")
    np.testing.assert_array_equal(read_reply(old), PLAN)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_tensors_are_read_without_torch(protocol):
    """VAD's client sends one: np.cumsum of a tensor is a tensor."""
    torch = pytest.importorskip("torch")
    tensor = torch.from_numpy(PLAN)
    for form in (
        tensor, tensor.float(), tensor.half(), tensor.long(), tensor.T.contiguous().T, torch.cat([tensor, tensor])[6:],
        torch.nn.Parameter(tensor).detach(), np.cumsum(np.diff(tensor, axis=0, prepend=0), axis=0),
    ):  # fmt: skip
        np.testing.assert_array_equal(read_reply(pickle.dumps(form, protocol)), PLAN)


class Runs:
    """Makes a folder when it is simply unpickled."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return os.mkdir, (self.path,)


def test_code_does_not_run(tmp_path):
    for protocol in PROTOCOLS:
        with pytest.raises(ClientError, match=r"(posix|nt)\.mkdir"):
            read_reply(pickle.dumps([PLAN, Runs(tmp_path / "ran")], protocol))
    assert not (tmp_path / "ran").exists()


REFUSED = {
    "names": [b"cbuiltins\neval\n(X\x03\x00\x00\x001+1tR.", b"cnumpy.core.multiarray\nfromfile\n)R.",
              b"(S'x'\nios\nsystem\n.", b"cnumpy\nndarray\n}X\x01\x00\x00\x00aI1\nsb."],
    "opcodes": [b"\x80\x02\x82\x01.", b"Pid\n.", pickle.dumps({"plan": 1}), pickle.dumps({1, 2}),
                b"})" + b"\x85" * 300_000 + b"Ns."],  # hashing that key would end the program
    "damage": [b"", b"\x00 nothing", pickle.dumps(PLAN)[:-20], b"\x80\x05\x96\xff\xff\xff\xff\xff\x00\x00\x00.",
               pickle.dumps(PLAN) + b"x", b"\x80\x04r\xff\xff\xff\xff."],
    "arrays": [b"cnumpy\nndarray\n((I100000000000\nI2\ntS'<f8'\ntR.", b"cnumpy\nndarray\n((I3\nI2\ntS'<f8'\ntR.",
               b"cnumpy\nndarray\n((" + b"I1\n" * 9 + b"tS'<f8'\ntR.", pickle.dumps(PLAN.astype("S8")),
               b"cnumpy\ndtype\n(" + b"(l" + b"p0\n(g0\ng0\ng0\ng0\nl" * 60 + b"tR."],
    "shapes": [pickle.dumps(each) for each in ("Done", np.float64(2), [0] * 10_001, PLAN.T, PLAN[None], PLAN[:0], [],
                                               np.zeros((1001, 2)), [[1.0, 2.0], [3.0]], [[1.0, "2"]])],
    "numbers": [pickle.dumps(each) for each in (PLAN * np.nan, [[1.0, np.inf]], 1e5 * PLAN, [[10**400, 1]])],
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_other_replies_are_refused(kind):
    for data in REFUSED[kind]:
        with pytest.raises(ClientError, match="the client sent"):
            read_reply(data)
