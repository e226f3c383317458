#version 430
// Finds the drops that may be visible to the camera: one thread tests 32 drops of a class and writes a bit for each. Most
// fail the first test. With ROOFS, drops under a roof are left out.
// No races: nothing is shared, and each thread writes its own mask and count.

layout(local_size_x = 256) in;

#include "common_drop_field.glsl"

layout(std430, binding = 2) writeonly buffer Found { uint found_masks[]; };
layout(std430, binding = 5) writeonly buffer Counts { uint found_counts[]; };

#ifdef ROOFS
layout(std430, binding = 3) readonly buffer Roofs { float roof_heights[]; };  // m above the centre, row by row
uniform ivec2 roof_size;      // columns, rows
uniform vec2 roof_corner;     // of the first, from the centre of the cell along the world's axes (m)
uniform float roof_edge;      // m
uniform mat2 cell_to_world;

bool is_sheltered(vec3 p) {
    ivec2 at = ivec2(floor((cell_to_world * p.xy - roof_corner) / roof_edge));
    if (any(lessThan(at, ivec2(0))) || any(greaterThanEqual(at, roof_size))) return false;
    return p.z < roof_heights[at.y * roof_size.x + at.x];
}
#endif

uniform uint count;           // drops with numbers below this exist
uniform uint masks_by_class;
uniform uint first_of_class;  // class c belongs to the drops c * this mod CLASSES, that plus CLASSES, and so on
uniform mat2 cell_to_region;
uniform vec3 region_half;     // m
uniform vec4 slopes;          // edges of the view: lowest and highest x/z, lowest and highest y/z

bool is_seen(uint i, uint c) {
    vec3 p = in_cell(place(i, c).at);
    if (abs(p.z) > region_half.z || any(greaterThan(abs(cell_to_region * p.xy), region_half.xy))) return false;
    vec3 q = cell_to_camera * (p - camera_in_cell);
    if (q.z < 0.0 || q.z > drop_classes[c].far) return false;
    float margin = drop_classes[c].margin;
#ifdef ROOFS
    if (is_sheltered(p)) return false;
#endif
    return q.x >= slopes.x * q.z - margin && q.x <= slopes.y * q.z + margin &&
           q.y >= slopes.z * q.z - margin && q.y <= slopes.w * q.z + margin;
}

void main() {
    uint at = gl_GlobalInvocationID.x, c = at / masks_by_class;
    if (c >= CLASSES) return;
    uint first = (at % masks_by_class) * 32u * CLASSES + c * first_of_class % CLASSES;
    uint mask = 0u;
    for (uint bit = 0u; bit < 32u; ++bit) {
        uint i = first + bit * CLASSES;
        if (i < count && is_seen(i, c)) mask |= 1u << bit;
    }
    found_masks[at] = mask;
    found_counts[at] = uint(bitCount(mask));
}
