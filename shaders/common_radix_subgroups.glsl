// Digits of the keys that a subgroup of 32 threads takes, counted in registers: thread n counts those whose digit is n, n + 32,
// n + 64 or n + 96, 16 bits each. Each subgroup takes 32 * ROUNDS keys in a row: the order of a workgroup's keys is that of
// subgroups, rounds, threads. Nothing waits for shared memory (the idea of Ashkiani et al. 2016, "GPU Multisplit").

#include "common_radix.glsl"

const uint SUBGROUPS = 8u, STRIDE = DIGITS + 1u;  // one more: rows start in different banks of memory

uint first_key() {
    return group() * KEYS_BY_GROUP + (gl_LocalInvocationIndex >> 5) * 32u * ROUNDS + (gl_LocalInvocationIndex & 31u);
}

// Counts one key of each thread. Returns how many keys of the same digit the subgroup had before this one.
uint tally_key(uint key, bool held, inout uvec2 tally) {
    uint lane = gl_LocalInvocationIndex & 31u, digit = digit_of(key);
    uint same = subgroupBallot(held).x, mine = same, ballots[DIGIT_BITS];
    for (uint b = 0u; b < DIGIT_BITS; ++b) {
        ballots[b] = subgroupBallot(((digit >> b) & 1u) != 0u).x;
        same &= ballots[b] ^ (((digit >> b) & 1u) - 1u);
    }
    for (uint b = 0u; b < 5u; ++b) mine &= ballots[b] ^ (((lane >> b) & 1u) - 1u);
    uint by_lane_x = subgroupShuffle(tally.x, digit & 31u), by_lane_y = subgroupShuffle(tally.y, digit & 31u);
    uint before = (((digit & 64u) != 0u ? by_lane_y : by_lane_x) >> ((digit & 32u) >> 1)) & 0xFFFFu;
    uint high = mine & ballots[6], low = mine & ~ballots[6];
    tally.x += uint(bitCount(low & ~ballots[5])) | uint(bitCount(low & ballots[5])) << 16;
    tally.y += uint(bitCount(high & ~ballots[5])) | uint(bitCount(high & ballots[5])) << 16;
    return before + uint(bitCount(same & ((1u << lane) - 1u)));
}

shared uint place[SUBGROUPS * STRIDE];  // by subgroup and digit

void share_tally(uvec2 tally) {
    uint at = (gl_LocalInvocationIndex >> 5) * STRIDE + (gl_LocalInvocationIndex & 31u);
    place[at] = tally.x & 0xFFFFu;
    place[at + 32u] = tally.x >> 16;
    place[at + 64u] = tally.y & 0xFFFFu;
    place[at + 96u] = tally.y >> 16;
}
