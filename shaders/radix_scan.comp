#version 430
// Converts the counts to offsets: an exclusive scan by one workgroup, each thread over a run of its own.
// No races: in each step of the scan all threads read `sums` before a barrier and write their own sum after it; no thread
// touches `counts` outside its run, and there is one workgroup.

layout(local_size_x = 1024) in;

layout(std430, binding = 4) buffer Counts { uint counts[]; };
layout(std430, binding = 7) readonly buffer Work { uint draw_command[5]; uint key_count; uint groups; };

const uint DIGITS = 16u;

shared uint sums[1024];

void main() {
    uint thread = gl_LocalInvocationID.x, entries = DIGITS * groups;
    uint run = (entries + 1023u) / 1024u;
    uint first = min(thread * run, entries), last = min(first + run, entries);
    uint sum = 0u;
    for (uint k = first; k < last; ++k) sum += counts[k];
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
        uint count = counts[k];
        counts[k] = place;
        place += count;
    }
}
