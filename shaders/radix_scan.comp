#version 430
// Converts the counts to offsets: an exclusive scan of each digit's row by one workgroup, each thread over a run of its own.
// No races: in each step of the scan all threads read `sums` before a barrier and write their own sum after it; no workgroup
// touches another row of `counts`; of `totals` those of this pass are read and those of the next one cleared.

#include "common_radix.glsl"

layout(std430, binding = 4) buffer Counts { uint counts[]; };
layout(std430, binding = 5) buffer Totals { uint totals[]; };

uniform uint turn;

shared uint sums[256];

void main() {
    uint thread = gl_LocalInvocationID.x, digit = gl_WorkGroupID.x, row = digit * groups();
    uint run = (groups() + 255u) / 256u;
    uint first = min(thread * run, groups()), last = min(first + run, groups());
    uint sum = 0u;
    for (uint k = first; k < last; ++k) sum += counts[row + k];
    uint before_row = thread < digit ? totals[turn * DIGITS + thread] : 0u;  // keys of a lower digit
    if (thread == 0u) totals[(1u - turn) * DIGITS + digit] = 0u;
    sums[thread] = before_row;
    barrier();
    for (uint step = 128u; step > 0u; step /= 2u) {
        uint added = thread < step ? sums[thread + step] : 0u;
        barrier();
        sums[thread] += added;
        barrier();
    }
    uint start = sums[0];
    barrier();
    sums[thread] = sum;
    barrier();
    for (uint step = 1u; step < 256u; step *= 2u) {
        uint before = thread >= step ? sums[thread - step] : 0u;
        barrier();
        sums[thread] += before;
        barrier();
    }
    uint place = start + sums[thread] - sum;
    for (uint k = first; k < last; ++k) {
        uint count = counts[row + k];
        counts[row + k] = place;
        place += count;
    }
}
