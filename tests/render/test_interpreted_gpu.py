"""The GPU made of Python by which shaders are checked: it computes as drivers do, and reports each kind of fault."""

import numpy as np
import pytest

from interpreted_gpu.context import InterpretedContext
from interpreted_gpu.values import UnsupportedError

HEAD = "#version 430\nlayout(local_size_x = 64) in;\n"
OUT = "layout(std430, binding = 0) buffer Out { uint result[]; };\n"


def run(context, body, words=64, groups=1, **uniforms):
    buffer = context.buffer(np.zeros(words, np.uint32))
    buffer.bind_to_storage_buffer(0)
    shader = context.compute_shader(HEAD + OUT + body)
    for name, value in uniforms.items():
        shader[name] = value
    shader.run(groups)
    context.memory_barrier()
    return np.frombuffer(buffer.read(), np.uint32)


ARITHMETIC = """
#define TWICE 2u
#if NOT_DEFINED > 1
wrong
#elif 3 > 2
uniform vec3 scale;
uniform mat3 turn;
#endif
struct Pair { uvec2 a; float b; };
const float THIRD = 1.0 / 3.0, SIXTH = THIRD * 0.5;
uint hash(uint x, out uint rest, inout uint steps) {
    x ^= x >> 16u; x *= 0x7feb352du; x ^= x >> 15u;
    rest = x % 7u;
    ++steps;
    return x;
}
float choose(int which, float x) {
    switch (which) {
        case 0: return x;
        case 1: x *= 3.0; break;
        default: x = -x;
    }
    return x + 0.25;
}
void main() {
    uint lane = gl_LocalInvocationID.x, rest = 0u, steps = 5u;
    int signed_lane = int(lane) - 32;
    uint hashed = hash(lane * TWICE + 1u, rest, steps);
    Pair pair;
    pair.a = uvec2(hashed << 3u, rest << 3u);
    pair.a.y -= 20u;
    pair.b = choose(signed_lane & 3, float(signed_lane));
    vec3 v = turn * (scale * float(lane)) + vec3(THIRD, SIXTH, 1.0).zyx;
    v.x += 1.5;
    uint sum = 0u;
    for (uint k = 0u; k < 8u; ++k) {
        if (k > lane / 8u) break;
        if ((k & 1u) == 0u) sum += k * k;
    }
    while (sum > 11u) sum -= 11u;
    result[lane * 8u] = pair.a.x ^ pair.a.y;
    result[lane * 8u + 1u] = floatBitsToUint(pair.b);
    result[lane * 8u + 2u] = uint(int(floor(dot(v, vec3(1.0, 2.0, 4.0)) * 64.0)));
    result[lane * 8u + 3u] = sum + 100u * steps;
    result[lane * 8u + 4u] = uint(signed_lane / 5) + uint(signed_lane >> 2) * 3u;
    uint counted = uint(findLSB(hashed | 256u)) + uint(bitCount(hashed));
    result[lane * 8u + 5u] = counted + uint(bitfieldExtract(signed_lane, 2, 4));
    result[lane * 8u + 6u] = any(lessThan(v, vec3(10.0))) && !all(greaterThan(v.xy, vec2(3.0))) ? lane : -lane;
    result[lane * 8u + 7u] = packHalf2x16(clamp(unpackHalf2x16(lane << 8u), vec2(0.0), vec2(lane)));
}
"""


def test_computes_what_a_driver_computes(context):
    values = {"scale": (0.5, -1.25, 2.0), "turn": (0.0, 1.0, 0.5, -1.0, 0.25, 0.0, 0.0, 0.5, 2.0)}
    interpreted = InterpretedContext(0)
    ours = run(interpreted, ARITHMETIC, 8 * 64, **values)
    assert list(interpreted.faults) == []
    np.testing.assert_array_equal(ours, run(context, ARITHMETIC, 8 * 64, **values))
    assert all(len(np.unique(column)) > 2 for column in ours.reshape(64, 8).T)


SHARED = "shared uint values[64];\nvoid main() {\n    uint lane = gl_LocalInvocationID.x;\n"
ADDED = "values[lane] = 0u; barrier(); atomicAdd(values[lane / 8u], lane);"


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


@pytest.mark.parametrize(
    "body", ["void main() { uint a[3]; }", "void main() { int a = 1.5; }", "#pragma unroll\nvoid main() {}"]
)
def test_refuses_what_it_does_not_know(body):
    with pytest.raises(UnsupportedError):
        InterpretedContext(0).compute_shader(HEAD + body)
