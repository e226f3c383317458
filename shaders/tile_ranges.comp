#version 430
// Finds where each tile's pairs begin among those sorted by tile, by bisection, one thread per tile.
// No races: nothing is shared, and each thread writes its own number.

layout(local_size_x = 256) in;

layout(std430, binding = 0) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 4) writeonly buffer Starts { uint starts[]; };
layout(std430, binding = 7) readonly buffer Pairs { uint unused[5]; uint pair_count; };

uniform uint tile_count;

void main() {
    uint tile = gl_GlobalInvocationID.x;
    if (tile > tile_count) return;
    uint low = 0u, high = pair_count;
    while (low < high) {
        uint middle = (low + high) / 2u;
        if (keys[middle] < tile) low = middle + 1u; else high = middle;
    }
    starts[tile] = low;
}
