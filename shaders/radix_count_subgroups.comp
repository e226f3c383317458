#version 430
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
// As radix_count.comp, where threads run in subgroups of 32.
// No races: `place` is written, then read, with a barrier between; each workgroup writes its own column of `counts`, and `totals`
// are changed by atomics only.

#include "common_radix_subgroups.glsl"

layout(std430, binding = 4) writeonly buffer Counts { uint counts[]; };  // digit by digit, workgroup by workgroup
layout(std430, binding = 5) buffer Totals { uint totals[]; };            // digit by digit, of two passes in turn

uniform uint turn;  // which of the two

void main() {
    if (group() >= groups()) return;
    uint thread = gl_LocalInvocationIndex, first = first_key(), key[ROUNDS];
    for (uint r = 0u; r < ROUNDS; ++r) key[r] = first + r * 32u < key_count ? keys[first + r * 32u] : 0u;
    uvec2 tally = uvec2(0u);
    for (uint r = 0u; r < ROUNDS; ++r) tally_key(key[r], first + r * 32u < key_count, tally);
    share_tally(tally);
    barrier();
    if (thread < DIGITS) {
        uint sum = 0u;
        for (uint k = 0u; k < SUBGROUPS; ++k) sum += place[k * STRIDE + thread];
        counts[thread * groups() + group()] = sum;
        atomicAdd(totals[turn * DIGITS + thread], sum);
    }
}
