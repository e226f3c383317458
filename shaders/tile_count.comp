#version 430
// Counts the tiles that each visible splat meets, nearest splat first, one thread per splat; and sums them up by 256.
// No races: `sum` is cleared, added to (by atomics only) and read between barriers; each thread writes its own count.

layout(local_size_x = 256) in;

#include "common_tile.glsl"

layout(std430, binding = 1) readonly buffer Order { uint order[]; };  // slots, nearest first
layout(std430, binding = 4) writeonly buffer TileCounts { uint tile_counts[]; };
layout(std430, binding = 5) writeonly buffer Counts { uint block_counts[]; };
layout(std430, binding = 7) readonly buffer Work { uint draw_command[5]; uint visible_count; };

shared uint sum;

void main() {
    uint block = gl_WorkGroupID.x + gl_WorkGroupID.y * gl_NumWorkGroups.x, lane = gl_LocalInvocationID.x;
    uint number = block * 256u + lane, count = 0u;
    if (block * 256u >= visible_count) return;
    if (lane == 0u) sum = 0u;
    barrier();
    if (number < visible_count) {
        Ellipse e = ellipse_of(load_splat(order[number]));
        uvec2 rows = rows_of(e);
        for (uint row = rows.x; row < rows.y; ++row) {
            uvec2 columns = columns_of(e, row);
            count += columns.y - columns.x;
        }
        tile_counts[number] = count;
        atomicAdd(sum, count);
    }
    barrier();
    if (lane == 0u) block_counts[block] = sum;
}
