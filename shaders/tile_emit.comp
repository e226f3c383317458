#version 430
// Writes a pair (tile, slot) for each tile that each visible splat meets, nearest splat first. The threads of a workgroup share
// the pairs of its 256 splats evenly: one splat may meet thousands of tiles, the next none.
// No races: the scan and the ellipses are written and read between barriers, and each pair has its own place.

layout(local_size_x = 256) in;

#include "common_tile.glsl"

layout(std430, binding = 0) writeonly buffer Keys { uint keys[]; };
layout(std430, binding = 1) readonly buffer Order { uint order[]; };
layout(std430, binding = 2) writeonly buffer Slots { uint slots[]; };
layout(std430, binding = 4) readonly buffer TileCounts { uint tile_counts[]; };
layout(std430, binding = 5) readonly buffer Places { uint block_places[]; };
layout(std430, binding = 6) readonly buffer Pairs { uint unused[5]; uint pair_count; };
layout(std430, binding = 7) readonly buffer Work { uint draw_command[5]; uint visible_count; };

const uint LONG = 2048u;    // pairs of 256 splats: 8 each

shared uint ends[256];      // pairs up to and with each splat
shared uint slot_of[256];
shared vec4 where[256];     // center, depth, shear
shared vec3 extent[256];    // spread, yy, turn

void main() {
    uint block = gl_WorkGroupID.x + gl_WorkGroupID.y * gl_NumWorkGroups.x, lane = gl_LocalInvocationID.x;
    uint number = block * 256u + lane;
    if (block * 256u >= visible_count) return;
    uint count = number < visible_count ? tile_counts[number] : 0u, slot = 0u;
    if (count > 0u) {
        slot = order[number];
        Ellipse e = ellipse_of(load_splat(slot));
        where[lane] = vec4(e.center, e.depth, e.shear);
        extent[lane] = vec3(e.spread, e.yy, e.turn);
    }
    slot_of[lane] = slot;
    ends[lane] = count;
    barrier();
    for (uint step = 1u; step < 256u; step *= 2u) {
        uint before = lane >= step ? ends[lane - step] : 0u;
        barrier();
        ends[lane] += before;
        barrier();
    }
    uint first = block_places[block], count_here = min(ends[255], max(pair_count, first) - first);
    // Where splats meet many tiles, each thread takes a run of pairs: it seeks splat and row once, not for each pair.
    uint run = count_here > LONG ? (count_here + 255u) / 256u : 0u;
    uint from = run > 0u ? lane * run : lane, to = run > 0u ? min(from + run, count_here) : count_here;
    uint found_up_to = 0u, passed = 0u, row = 0u;
    uvec2 rows = uvec2(0u), columns = uvec2(0u);
    Ellipse e;
    for (uint at = from; at < to; at += run > 0u ? 1u : 256u) {
        if (at >= found_up_to) {
            uint low = 0u, high = 255u;
            while (low < high) {
                uint middle = (low + high) / 2u;
                if (ends[middle] > at) high = middle; else low = middle + 1u;
            }
            vec4 w = where[low];
            vec3 x = extent[low];
            e = Ellipse(w.xy, w.z, w.w, x.x, x.y, x.z);
            rows = rows_of(e);
            row = rows.x;
            columns = columns_of(e, row);
            passed = low > 0u ? ends[low - 1u] : 0u;
            slot = slot_of[low];
            found_up_to = run > 0u ? ends[low] : 0u;
        }
        while (row < rows.y && at - passed >= columns.y - columns.x) {
            passed += columns.y - columns.x;
            row += 1u;
            columns = columns_of(e, row);
        }
        // No tile where the driver rounds otherwise than when it counted.
        keys[first + at] = row < rows.y ? row * tiles.x + columns.x + at - passed : tiles.x * tiles.y;
        slots[first + at] = slot;
    }
}
