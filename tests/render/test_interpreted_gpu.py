"""The GPU made of Python by which shaders are checked: it reports each kind of fault.

That it computes what drivers compute, `test_shader_races.py` checks by the shaders themselves.
"""

import numpy as np
import pytest

from interpreted_gpu.context import InterpretedContext
from interpreted_gpu.values import UnsupportedError

HEAD = "#version 430\nlayout(local_size_x = 64) in;\n"
OUT = "layout(std430, binding = 0) buffer Out { uint result[]; };\n"


SHARED = "shared uint values[64];\nvoid main() {\n    uint lane = gl_LocalInvocationID.x;\n"
BALLOT = "uint odd = subgroupBallot((lane & 1u) == 1u).x;\n"
ADDED = "values[lane] = 0u; barrier(); atomicAdd(values[lane / 8u], lane);"


def run(context, body):
    context.buffer(np.zeros(64, np.uint32)).bind_to_storage_buffer(0)
    context.compute_shader(HEAD + OUT + body).run(1)


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ("values[lane] = lane; barrier(); result[lane] = values[63u - lane]; }", None),
        ("values[lane] = lane; result[lane] = values[63u - lane]; }", "line 7 writes values"),
        ("values[0] = 7u; }", "line 7 writes and line 7 writes values"),
        (ADDED + " barrier(); result[lane] = values[lane]; }", None),
        (ADDED + "\nif (lane == 3u) result[0] = values[0]; }", "line 7 changes and line 8 reads values"),
        ("if (lane < 32u) barrier(); }", "not all threads come to the barrier of line 7"),
        ("if (lane < 32u) barrier(); else\nbarrier(); }", "not all threads come to the barrier"),
        ("values[lane + 1u] = 0u; }", "line 7 takes element 64 of 64"),
        ("result[lane + 1u] = 0u; }", "line 7 is outside of Out"),
        ("result[lane] = values[lane]; }", "line 7 reads of values what nobody has written"),
        # A barrier orders what is shared, not buffers.
        ("result[lane] = lane; barrier(); values[lane] = result[63u - lane]; }", "line 7 writes Out"),
        ("atomicAdd(result[0], lane); }", None),
        (BALLOT + "result[lane] = odd; }", None),
        ("if (lane < 31u) subgroupBallot(true); }", "not all threads of a subgroup come to line 7"),
    ],
)
def test_reports_each_kind_of_fault_whoever_comes_first(body, fault):
    for seed, warps in [(0, False), (1, False), (2, True), (3, True)]:
        context = InterpretedContext(seed, warps=warps)
        run(context, SHARED + body)
        if fault is None:
            assert list(context.faults) == []
        else:
            assert any(fault in each for each in context.faults), list(context.faults)


LANES = np.arange(64, dtype=np.uint32)


@pytest.mark.parametrize("warps", [False, True])
@pytest.mark.parametrize(
    ("body", "expected"),
    [
        (BALLOT + "result[lane] = odd + lane; }", 0xAAAAAAAA + LANES),
        ("result[lane] = subgroupShuffle(lane, (lane + 3u) & 31u); }", LANES // 32 * 32 + (LANES + 3) % 32),
        ("result[lane] = subgroupInclusiveAdd(lane); }", np.cumsum(LANES.reshape(2, 32), axis=1).ravel()),
    ],
)
def test_the_threads_of_a_subgroup_exchange_numbers(body, expected, warps):
    context = InterpretedContext(0, warps=warps)
    result = context.buffer(np.zeros(64, np.uint32))
    result.bind_to_storage_buffer(0)
    context.compute_shader(HEAD + OUT + SHARED + body).run(1)
    np.testing.assert_array_equal(np.frombuffer(result.read(), np.uint32), expected)


@pytest.mark.parametrize(
    "body",
    ["void main() { uint a = 1u; a[0] = 2u; }", "void main() { int a = 1.5; }", "#line 3\nvoid main() {}"],
)
def test_refuses_what_it_does_not_know(body):
    with pytest.raises(UnsupportedError):
        InterpretedContext(0).compute_shader(HEAD + body)
