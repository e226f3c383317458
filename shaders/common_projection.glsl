// Projected splats of a compute shader: visible ones are packed and written with keys for the sort.

#define SPLAT_ACCESS writeonly
#include "common_ellipse.glsl"
#ifdef LENS
#include "common_lens.glsl"
#endif
#include "common_splat_blocks.glsl"

layout(std430, binding = 4) writeonly buffer Keys { uint sparse_keys[]; };    // of visible splats, packed block by block
layout(std430, binding = 5) writeonly buffer Counts { uint block_counts[]; };  // visible splats of each 256 slots

uniform uint first_slot;          // where this dispatch's splats start, a multiple of 256

shared uint visible_mask[8];

// Packs the visible splats of a workgroup of 256 to the front of a block of 256 slots, in the order of its threads. Every
// thread calls it, `visible` or not, as often as it likes; `block` counts from the dispatch's first slot.
// No races: `visible_mask` is cleared, set (by atomics only) and read between barriers, the last of which lets the next call
// clear it; ranks differ, so each splat has a slot of its own.
void emit(bool visible, Splat splat, uint block) {
    uint lane = gl_LocalInvocationID.x, word = lane >> 5;
    if (lane < 8u) visible_mask[lane] = 0u;
    barrier();
    if (visible) atomicOr(visible_mask[word], 1u << (lane & 31u));
    barrier();
    uint rank = uint(bitCount(visible_mask[word] & ((1u << (lane & 31u)) - 1u))), total = 0u;
    for (uint k = 0u; k < 8u; ++k) {
        uint count = uint(bitCount(visible_mask[k]));
        if (k < word) rank += count;
        total += count;
    }
    barrier();
    if (lane == 0u) block_counts[first_slot / 256u + block] = total;
    if (!visible) return;
    uint slot = first_slot + block * 256u + rank;
    // The bits of a positive float sort like the number itself; 28 bits tell all depths up to 8e8 m apart.
    sparse_keys[slot] = min(floatBitsToUint(splat.depth) - floatBitsToUint(near), 0x0FFFFFFFu);
    uint place = slot & ((1u << BLOCK_SHIFT) - 1u);
    switch (slot >> BLOCK_SHIFT) {
        case 0u: splats0[place] = splat; break;
#if SPLAT_BLOCKS > 1
        case 1u: splats1[place] = splat; break;
#endif
#if SPLAT_BLOCKS > 2
        case 2u: splats2[place] = splat; break;
#endif
#if SPLAT_BLOCKS > 3
        case 3u: splats3[place] = splat; break;
#endif
    }
}
