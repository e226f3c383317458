#version 430
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
// As radix_scatter.comp, where threads run in subgroups of 32.
// No races: a subgroup's row of `place` is read before a barrier of the subgroup and written after it, by one thread for each
// digit; the rows are scanned between barriers of the workgroup. Each key has its own place.

#include "common_radix.glsl"

layout(std430, binding = 1) readonly buffer Slots { uint slots[]; };
layout(std430, binding = 2) writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(std430, binding = 3) writeonly buffer SortedSlots { uint sorted_slots[]; };
layout(std430, binding = 4) readonly buffer Places { uint places[]; };

const uint STRIDE = DIGITS + 1u;  // one more: the rows of `place` start in different banks of memory

shared uint place[8u * STRIDE];  // by subgroup: keys of each digit so far, then where its next key goes

// Each subgroup takes 32 * ROUNDS keys in a row, so that the order is that of subgroups, rounds, threads.
void main() {
    uint thread = gl_LocalInvocationIndex, lane = thread & 31u, row = (thread >> 5) * STRIDE;
    uint first = gl_WorkGroupID.x * KEYS_BY_GROUP + (thread >> 5) * 32u * ROUNDS + lane;
    uint lower = (1u << lane) - 1u;
    for (uint k = thread; k < 8u * STRIDE; k += 256u) place[k] = 0u;
    barrier();
    uint key[ROUNDS], rank[ROUNDS];
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint at = first + r * 32u;
        key[r] = at < key_count ? keys[at] : 0u;
        uint digit = at < key_count ? digit_of(key[r]) : DIGITS;
        uint same = 0xFFFFFFFFu;  // threads of the subgroup with this digit
        for (uint b = 0u; b <= DIGIT_BITS; ++b) {
            bool on = ((digit >> b) & 1u) != 0u;
            uint ballot = subgroupBallot(on).x;
            same &= on ? ballot : ~ballot;
        }
        uint before = place[row + digit];
        subgroupMemoryBarrierShared();
        subgroupBarrier();
        rank[r] = before + uint(bitCount(same & lower));
        if ((same & lower) == 0u) place[row + digit] = before + uint(bitCount(same));
        subgroupMemoryBarrierShared();
        subgroupBarrier();
    }
    barrier();
    if (thread < DIGITS) {
        uint to = places[thread * groups + gl_WorkGroupID.x];
        for (uint k = 0u; k < 8u; ++k) {
            uint count = place[k * STRIDE + thread];
            place[k * STRIDE + thread] = to;
            to += count;
        }
    }
    barrier();
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint at = first + r * 32u;
        if (at < key_count) {
            uint to = place[row + digit_of(key[r])] + rank[r];
            sorted_keys[to] = key[r];
            sorted_slots[to] = slots[at];
        }
    }
}
