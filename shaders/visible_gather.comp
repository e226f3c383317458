#version 430
// Compacts the keys of all visible splats, in the order of their slots. One thread per slot.
// No races: nothing is shared, and the scanned places of two blocks don't overlap.

layout(local_size_x = 256) in;

layout(std430, binding = 0) writeonly buffer Keys { uint keys[]; };
layout(std430, binding = 1) writeonly buffer Slots { uint slots[]; };
layout(std430, binding = 4) readonly buffer SparseKeys { uint sparse_keys[]; };
layout(std430, binding = 5) readonly buffer Places { uint block_places[]; };
layout(std430, binding = 7) readonly buffer Work { uint draw_command[5]; uint visible_count; };

uniform uint blocks;

void main() {
    uint block = gl_WorkGroupID.x + gl_WorkGroupID.y * gl_NumWorkGroups.x, lane = gl_LocalInvocationID.x;
    if (block >= blocks) return;
    uint place = block_places[block];
    uint next = block + 1u < blocks ? block_places[block + 1u] : visible_count;
    if (lane >= next - place) return;
    uint slot = block * 256u + lane;
    keys[place + lane] = sparse_keys[slot];
    slots[place + lane] = slot;
}
