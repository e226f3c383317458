#version 430
// One quad a splat, vertex-pulled, farthest first.

#include "common_splat.glsl"

layout(std430, binding = 4) readonly buffer Splats { Splat splats[]; };
layout(std430, binding = 6) readonly buffer Order { uint order[]; };

uniform vec2 image_size;  // px

out vec2 deviations;           // distance from the centre in standard deviations
flat out vec4 color_alpha;     // display colour, largest alpha
flat out float view_depth;     // m
flat out int is_rain;

void main() {
    Splat splat = splats[order[gl_InstanceID]];
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
    deviations = corner * abs(splat.extent.w);
    color_alpha = vec4(splat.appearance.rgb, splat.extent.z);
    view_depth = splat.appearance.a;
    is_rain = splat.extent.w < 0.0 ? 1 : 0;
    vec2 pixel = splat.ellipse.xy + deviations.x * splat.ellipse.zw + deviations.y * splat.extent.xy;
    // The image's first row is the framebuffer's first row: no flip when reading back or showing.
    gl_Position = vec4(2.0 * pixel / image_size - 1.0, 0.0, 1.0);
}
