#version 300 es
// Light that facets of a page's water reflect, blurred by those that tilt across the line of sight, as _blur_rows of
// gsrain_engine/water/mirror.py: that of the map's films, of which a share is flooded, and that of its standing water.

precision highp float;
precision highp sampler2D;

#include "common_page_mirror.glsl"

uniform sampler2D light, films, standing;  // as page_mirror_light.frag and page_mirror_columns.frag write them
uniform vec2 slopes;                       // standard deviations of the slope of films and of standing water
uniform vec4 weights;                      // of films and of standing water in the light of films, and in that of standing water

layout(location = 0) out vec4 of_films;
layout(location = 1) out vec4 of_standing;

vec3 blurred(sampler2D image, ivec2 pixel, float across) {
    vec4 sum = vec4(0.0);
    int reach = across > 0.4 ? 2 : 0;
    for (int tap = -reach; tap <= reach; ++tap) {
        float offset = 0.9 * float(tap);
        int column = clamp(int(floor(float(pixel.x) + across * offset + 0.5)), 0, mirror_size.x - 1);
        sum += exp(-0.5 * offset * offset) * vec4(texelFetch(image, ivec2(column, pixel.y), 0).rgb, 1.0);
    }
    return sum.rgb / sum.a;
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float beyond = texelFetch(light, pixel, 0).a;
    of_films = of_standing = vec4(0.0);
    if (beyond < 0.0) return;
    vec2 across = 2.0 * slopes * sine_to_ground(ray_of(pixel)) * intrinsics.x * beyond;
    vec3 film = blurred(films, pixel, across.x), water = blurred(standing, pixel, across.y);
    of_films = vec4(weights.x * film + weights.y * water, 1.0);
    of_standing = vec4(weights.z * film + weights.w * water, 1.0);
}
