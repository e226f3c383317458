#version 430
// Moves keys and their slots to the offsets of their digits; equal digits keep their order.
// No races: `mask` is cleared, set (by atomics only) and read between barriers, `place` is read and advanced between barriers,
// the last of which ends the round: `mask` is cleared for the next one when no thread reads it. Each key has its own place.
// With subgroups of 32 threads (SUBGROUPS) a row of `place` belongs to one subgroup, whose threads read it before a subgroup's
// barrier and write it after one, each digit by one thread.

#ifdef SUBGROUPS
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#endif

#include "common_radix.glsl"

layout(std430, binding = 1) readonly buffer Slots { uint slots[]; };
layout(std430, binding = 2) writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(std430, binding = 3) writeonly buffer SortedSlots { uint sorted_slots[]; };
layout(std430, binding = 4) readonly buffer Places { uint places[]; };

#ifdef SUBGROUPS
const uint STRIDE = DIGITS + 1u;  // one more: the rows of `place` start in different banks of memory

shared uint place[8u * STRIDE];  // by subgroup: keys of each digit so far, then where its next key goes

// Each subgroup takes 512 keys in a row, so that the order is that of subgroups, rounds, threads.
void main() {
    uint thread = gl_LocalInvocationIndex, lane = thread & 31u, row = (thread >> 5) * STRIDE;
    uint first = gl_WorkGroupID.x * KEYS_BY_GROUP + (thread >> 5) * 512u + lane;
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
#else
shared uint place[DIGITS];      // where the next key of each digit goes
shared uint mask[DIGITS * 8u];  // which of the 256 threads have the digit in this round

void main() {
    uint lane = gl_LocalInvocationID.x, word = lane >> 5, bit = 1u << (lane & 31u);
    if (lane < DIGITS) place[lane] = places[lane * groups + gl_WorkGroupID.x];
    for (uint r = 0u; r < ROUNDS; ++r) {
        for (uint k = lane; k < DIGITS * 8u; k += 256u) mask[k] = 0u;
        barrier();
        uint at = gl_WorkGroupID.x * KEYS_BY_GROUP + r * 256u + lane;
        bool held = at < key_count;
        uint key = held ? keys[at] : 0u, digit = digit_of(key);
        if (held) atomicOr(mask[digit * 8u + word], bit);
        barrier();
        if (held) {
            uint rank = uint(bitCount(mask[digit * 8u + word] & (bit - 1u)));
            for (uint k = 0u; k < word; ++k) rank += uint(bitCount(mask[digit * 8u + k]));
            uint to = place[digit] + rank;
            sorted_keys[to] = key;
            sorted_slots[to] = slots[at];
        }
        barrier();
        if (lane < DIGITS) {
            uint sum = 0u;
            for (uint k = 0u; k < 8u; ++k) sum += uint(bitCount(mask[lane * 8u + k]));
            place[lane] += sum;
        }
        barrier();
    }
}
#endif
