#version 430
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_KHR_shader_subgroup_arithmetic : require
// As radix_scatter.comp, where threads run in subgroups of 32. The keys of a workgroup are brought into their order first, so that
// those of a digit are written side by side.
// No races: each shared array is written, then read, with a barrier of the workgroup between. Each key has its own place.

#include "common_radix_subgroups.glsl"

layout(std430, binding = 1) readonly buffer Slots { uint slots[]; };
layout(std430, binding = 2) writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(std430, binding = 3) writeonly buffer SortedSlots { uint sorted_slots[]; };
layout(std430, binding = 4) readonly buffer Places { uint places[]; };

shared uint digits_before[DIGITS / 32u];  // keys of each 32 digits
shared uint to_global[DIGITS];            // from a key's place in the workgroup to that among all
shared uint ordered_keys[KEYS_BY_GROUP];
shared uint ordered_slots[KEYS_BY_GROUP];

void main() {
    if (group() >= groups()) return;
    uint thread = gl_LocalInvocationIndex, row = (thread >> 5) * STRIDE, first = first_key();
    uint key[ROUNDS], slot[ROUNDS], rank[ROUNDS];
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint at = first + r * 32u;
        key[r] = at < key_count ? keys[at] : 0u;
        slot[r] = at < key_count ? slots[at] : 0u;
    }
    uint to = thread < DIGITS ? places[thread * groups() + group()] : 0u;
    uvec2 tally = uvec2(0u);
    for (uint r = 0u; r < ROUNDS; ++r) rank[r] = tally_key(key[r], first + r * 32u < key_count, tally);
    share_tally(tally);
    barrier();
    uint total = 0u;  // keys of the digit `thread`
    if (thread < DIGITS) for (uint k = 0u; k < SUBGROUPS; ++k) total += place[k * STRIDE + thread];
    uint up_to = subgroupInclusiveAdd(total);
    if (thread < DIGITS && (thread & 31u) == 31u) digits_before[thread >> 5] = up_to;
    barrier();
    if (thread < DIGITS) {
        uint start = up_to - total;
        for (uint k = 0u; k < (thread >> 5); ++k) start += digits_before[k];
        to_global[thread] = to - start;
        for (uint k = 0u; k < SUBGROUPS; ++k) {
            uint count = place[k * STRIDE + thread];
            place[k * STRIDE + thread] = start;
            start += count;
        }
    }
    barrier();
    for (uint r = 0u; r < ROUNDS; ++r) {
        if (first + r * 32u < key_count) {
            uint at = place[row + digit_of(key[r])] + rank[r];
            ordered_keys[at] = key[r];
            ordered_slots[at] = slot[r];
        }
    }
    barrier();
    uint count = min(KEYS_BY_GROUP, key_count - group() * KEYS_BY_GROUP);
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint at = r * 256u + thread;
        if (at < count) {
            uint moved = ordered_keys[at], into = at + to_global[digit_of(moved)];
            sorted_keys[into] = moved;
            sorted_slots[into] = ordered_slots[at];
        }
    }
}
