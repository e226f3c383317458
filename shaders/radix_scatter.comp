#version 430
// Moves keys and their slots to the offsets of their digits; equal digits keep their order.
// No races: `mask` is cleared, set (by atomics only) and read between barriers, `place` is read and advanced between barriers,
// the last of which ends the round: `mask` is cleared for the next one when no thread reads it. Each key has its own place.

#include "common_radix.glsl"

layout(std430, binding = 1) readonly buffer Slots { uint slots[]; };
layout(std430, binding = 2) writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(std430, binding = 3) writeonly buffer SortedSlots { uint sorted_slots[]; };
layout(std430, binding = 4) readonly buffer Places { uint places[]; };

shared uint place[DIGITS];      // where the next key of each digit goes
shared uint mask[DIGITS * 8u];  // which of the 256 threads have the digit in this round

void main() {
    uint lane = gl_LocalInvocationID.x, word = lane >> 5, bit = 1u << (lane & 31u);
    if (group() >= groups()) return;
    if (lane < DIGITS) place[lane] = places[lane * groups() + group()];
    for (uint r = 0u; r < ROUNDS; ++r) {
        for (uint k = lane; k < DIGITS * 8u; k += 256u) mask[k] = 0u;
        barrier();
        uint at = group() * KEYS_BY_GROUP + r * 256u + lane;
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
