"""Pickles that NumPy 1 reads: by what they name, and by trying where an old NumPy is at hand."""

import io
import os
import pickle
import subprocess

import numpy as np
import pytest

from gsrain_engine.simulation.interop.hugsim_pickle import old_pickle

VALUE = {
    "image": np.arange(24, dtype=np.uint8).reshape(2, 4, 3), "turned": np.eye(4)[::-1].T, "empty": np.zeros((0, 2)),
    "depth": np.full((2, 2), 1.5, np.float32), "single": np.array(2.5), "float": np.float64(0.1), "int": np.int64(3),
    "bool": np.bool_(True), "nested": [(np.float32(0.5), "text", None)],
}  # fmt: skip


class Listening(pickle.Unpickler):
    """Notes what a stream calls by name."""

    def __init__(self, stream):
        super().__init__(io.BytesIO(stream))
        self.names = set()

    def find_class(self, module, name):
        self.names.add((module, name))
        return super().find_class(module, name)


def names_in(stream):
    listening = Listening(stream)
    listening.load()
    return listening.names


def test_stream_names_numpy_and_nothing_inside_it():
    stream = bytes(old_pickle(VALUE))
    assert b"numpy._core" not in stream and b"numpy.core" not in stream
    assert stream[:2] == b"\x80\x04"
    assert ("numpy", "ndarray") in names_in(stream)
    assert {module for module, _ in names_in(stream)} == {"numpy", "builtins"}


def test_a_plain_pickle_would_name_it():
    """Reason for this file: should NumPy's pickles ever be readable by old versions, it can go."""
    assert b"numpy._core" in pickle.dumps(VALUE, 4)


def test_values_come_back_and_can_be_written_to():
    back = pickle.loads(old_pickle(VALUE))
    for name in ("image", "turned", "empty", "depth", "single"):
        np.testing.assert_array_equal(back[name], VALUE[name])
        assert back[name].dtype == VALUE[name].dtype and back[name].flags.writeable
    assert back["nested"] == [(0.5, "text", None)]
    kinds = [type(back[name]) for name in ("float", "int", "bool")]
    assert kinds == [float, int, bool] and back["float"] == 0.1


def test_objects_are_refused():
    with pytest.raises(TypeError, match="has no bytes to send"):
        old_pickle(np.array([object()]))


def test_same_bytes_each_time():
    assert bytes(old_pickle(VALUE)) == bytes(old_pickle(VALUE))


def test_numpy_1_reads_them(tmp_path):
    python = os.environ.get("GSRAIN_OLD_NUMPY_PYTHON")
    if python is None:
        pytest.skip("no Python with NumPy 1 (set GSRAIN_OLD_NUMPY_PYTHON)")
    (tmp_path / "value.pkl").write_bytes(old_pickle(VALUE))
    code = (
        "import pickle, sys, numpy as np; v = pickle.load(open(sys.argv[1], 'rb')); v['image'][0, 0, 0] = 7;"
        "print(np.__version__.split('.')[0], v['image'].sum(), v['turned'][0, 3], v['depth'].dtype, v['float'])"
    )
    ran = subprocess.run([python, "-c", code, tmp_path / "value.pkl"], capture_output=True, text=True, check=False)
    assert ran.stdout.split() == ["1", "283", "1.0", "float32", "0.1"], ran.stderr
