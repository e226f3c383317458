#version 300 es
// Quads of a page's splats, farthest first: 128 for each instance, as splat.vert.

precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;

#include "common_alpha.glsl"
#include "common_splat.glsl"

uniform usampler2D shapes, rests;  // as page_project.frag writes them
uniform usampler2D order;          // numbers of splats
uniform vec2 image_size;           // px
uniform int drawn_count, scene_count, first_streak_row;
uniform bool falls;                // false leaves out streaks
uniform sampler2D water;           // shares of film and standing water of each Gaussian
uniform bool is_mirrored;          // depth takes the place of water

out vec2 offset;
flat out vec4 color_log_alpha;
flat out vec2 more;                // water, or depth (m)
flat out int is_rain;

const float STANDARD_DEVIATIONS = 1.17741002251547;  // sqrt(2 log 2), of offset 1

void main() {
    int number = gl_InstanceID * 128 + (gl_VertexID >> 2);
    gl_Position = vec4(2.0, 2.0, 0.0, 1.0);
    if (number >= drawn_count) return;
    int splat = int(texelFetch(order, ivec2(number % SPLAT_COLUMNS, number / SPLAT_COLUMNS), 0).r);
    is_rain = splat >= scene_count ? 1 : 0;
    if (is_rain != 0) {
        if (!falls) return;
        splat += first_streak_row * SPLAT_COLUMNS - scene_count;
    }
    ivec2 at = ivec2(splat % SPLAT_COLUMNS, splat / SPLAT_COLUMNS);
    uvec4 rest = texelFetch(rests, at, 0);
    float alpha = alpha_in(rest.zw);
    if (!(alpha > 0.0)) return;
    more = is_mirrored ? vec2(uintBitsToFloat(rest.y), 0.0) : is_rain != 0 ? vec2(0.0) : texelFetch(water, at, 0).rg;
    vec4 shape = uintBitsToFloat(texelFetch(shapes, at, 0));
    color_log_alpha = vec4(color_in(rest.zw), log2(alpha));
    float reach = sqrt(max(color_log_alpha.a - log2(is_rain != 0 ? RAIN_ALPHA_CUT : SCENE_ALPHA_CUT), 0.0));
    offset = reach * (vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0);
    vec2 deviations = STANDARD_DEVIATIONS * offset;
    vec2 second_axis = abs(uintBitsToFloat(rest.x)) * normalize(vec2(-shape.w, shape.z));
    vec2 pixel = shape.xy + deviations.x * shape.zw + deviations.y * second_axis;
    gl_Position = vec4(2.0 * pixel / image_size - 1.0, 0.0, 1.0);
}
