#version 430
// Quads of splats, farthest first, vertex-pulled: 128 per instance, four vertices each.
// No races: buffers are only read, behind a memory barrier after the sort; the next frame writes them behind another one.

#define SPLAT_ACCESS readonly
#define LOADS_SPLATS
#include "common_alpha.glsl"
#include "common_splat.glsl"
#include "common_splat_blocks.glsl"

layout(std430, binding = 1) readonly buffer Order { uint order[]; };  // slots, nearest first
layout(std430, binding = 7) readonly buffer Work { uint draw_command[5]; uint visible_count; };

uniform vec2 image_size;  // px

out vec2 offset;                // from the centre, scaled so that alpha falls by 2^-(offset^2)
flat out vec4 color_log_alpha;  // display color, log2 of the largest alpha
flat out float view_depth;      // m
flat out int is_rain;

const float STANDARD_DEVIATIONS = sqrt(2.0 * log(2.0));  // of offset 1

void main() {
    uint number = uint(gl_InstanceID) * 128u + uint(gl_VertexID >> 2);
    if (number >= visible_count) {  // the rest of the last instance: a quad of no area
        gl_Position = vec4(2.0, 2.0, 0.0, 1.0);
        return;
    }
    Splat splat = load_splat(order[visible_count - 1u - number]);
    color_log_alpha = vec4(color_in(splat.appearance), log2(alpha_in(splat.appearance)));
    view_depth = splat.depth;
    is_rain = splat.second < 0.0 ? 1 : 0;
    float cut = is_rain != 0 ? RAIN_ALPHA_CUT : SCENE_ALPHA_CUT;
#ifdef ELLIPSOIDS
    cut = SURFACE_ALPHA;
#endif
    float reach = sqrt(max(color_log_alpha.a - log2(cut), 0.0));  // exact: alpha is the cut at the edge
    offset = reach * (vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0);
    vec2 deviations = STANDARD_DEVIATIONS * offset;
    vec2 second_axis = abs(splat.second) * normalize(vec2(-splat.first_axis.y, splat.first_axis.x));
    vec2 pixel = splat.center + deviations.x * splat.first_axis + deviations.y * second_axis;
    // The image's first row is the framebuffer's first row: no flip when reading back or showing.
    gl_Position = vec4(2.0 * pixel / image_size - 1.0, 0.0, 1.0);
}
