#version 430
// Offsets of the visible splats (or found drops) of each block of 256, and their number: an exclusive scan of the
// counts by one workgroup, each thread over a run of its own.
// No races: as in radix_scan.comp; only the last thread writes `Work`, and `FoundWork` is another buffer.

layout(local_size_x = 1024) in;

layout(std430, binding = 5) buffer Counts { uint block_counts[]; };  // in: counts, out: first places
layout(std430, binding = 7) writeonly buffer Work {
    uint draw_command[5];    // of an indirect indexed draw: indices, instances, first index, base vertex, base instance
    uint visible_count;      // at most `max_elements`
    uint all_count;
};

layout(std430, binding = 6) readonly buffer FoundWork { uint unused[5]; uint found_count; };

uniform uint blocks;
uniform uint fixed_blocks;   // whose counts have been written
uniform uint found_copies;   // further blocks for each 256 found drops
uniform uint max_elements;   // more than these are only counted

const uint DRAWN_BY_INSTANCE = 128u;

shared uint sums[1024];

void main() {
    uint thread = gl_LocalInvocationID.x;
    uint run = (blocks + 1023u) / 1024u;
    uint first = thread * run, last = min(first + run, blocks);
    uint written = fixed_blocks + (found_copies > 0u ? found_copies * ((found_count + 255u) / 256u) : 0u);
    uint sum = 0u;
    for (uint k = first; k < min(last, written); ++k) sum += block_counts[k];
    sums[thread] = sum;
    barrier();
    for (uint step = 1u; step < 1024u; step *= 2u) {
        uint before = thread >= step ? sums[thread - step] : 0u;
        barrier();
        sums[thread] += before;
        barrier();
    }
    uint place = sums[thread] - sum;
    for (uint k = first; k < last; ++k) {
        uint count = k < written ? block_counts[k] : 0u;
        block_counts[k] = place;
        place += count;
    }
    if (thread == 1023u) {
        uint total = min(sums[1023], max_elements);
        all_count = sums[1023];
        visible_count = total;
        draw_command[0] = 6u * DRAWN_BY_INSTANCE;
        draw_command[1] = (total + DRAWN_BY_INSTANCE - 1u) / DRAWN_BY_INSTANCE;
        draw_command[2] = 0u;
        draw_command[3] = 0u;
        draw_command[4] = 0u;
    }
}
