#version 430
// Counts each digit among the keys of each workgroup, and among all keys.
// No races: `tally` is cleared, counted into (by atomics only) and read between barriers; each workgroup writes its own column
// of `counts`, and `totals` are changed by atomics only.

#include "common_radix.glsl"

layout(std430, binding = 4) writeonly buffer Counts { uint counts[]; };  // digit by digit, workgroup by workgroup
layout(std430, binding = 5) buffer Totals { uint totals[]; };            // digit by digit, of two passes in turn

uniform uint turn;  // which of the two

shared uint tally[DIGITS];

void main() {
    uint lane = gl_LocalInvocationID.x;
    if (group() >= groups()) return;
    if (lane < DIGITS) tally[lane] = 0u;
    barrier();
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint at = group() * KEYS_BY_GROUP + r * 256u + lane;
        if (at < key_count) atomicAdd(tally[digit_of(keys[at])], 1u);
    }
    barrier();
    if (lane < DIGITS) {
        counts[lane * groups() + group()] = tally[lane];
        atomicAdd(totals[turn * DIGITS + lane], tally[lane]);
    }
}
