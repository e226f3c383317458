#version 300 es
// Adds the rain's light to the scene's, and what its wet ground reflects, and shows the picture, whose first row is the
// uppermost.

precision highp float;
precision highp sampler2D;

#include "common_srgb.glsl"
#include "common_rain_light.glsl"

uniform sampler2D clear_scene, shares;
uniform vec3 rain_light;
uniform ivec2 screen;              // px of the canvas
uniform sampler2D water;           // visible shares of films (red) and standing water (green)
uniform sampler2D films, standing; // light that both reflect, as page_mirror_rows.frag writes it
uniform ivec2 mirror_size;         // px; 0 without a mirror
uniform vec2 mirror_scales;        // of the mirror image relative to the picture
uniform int first_row;             // of the picture, at that scale, in the mirror image

out vec4 color;

vec3 reflected(ivec2 at) {
    vec2 share = texelFetch(water, at, 0).rg;
    if (!(share.r + share.g > 0.0)) return vec3(0.0);
    vec2 place = mirror_scales * (vec2(at) + 0.5) - vec2(0.5, 0.5 + float(first_row));
    place = clamp(place, vec2(0.0), vec2(mirror_size - 1));
    ivec2 low = min(ivec2(place), max(mirror_size - 2, 0)), high = min(low + 1, mirror_size - 1);
    vec2 part = place - vec2(low);
    vec3 light = vec3(0.0);
    for (int corner = 0; corner < 4; ++corner) {
        ivec2 there = ivec2((corner & 1) != 0 ? high.x : low.x, (corner & 2) != 0 ? high.y : low.y);
        float weight = ((corner & 1) != 0 ? part.x : 1.0 - part.x) * ((corner & 2) != 0 ? part.y : 1.0 - part.y);
        light += weight * (share.r * texelFetch(films, there, 0).rgb + share.g * texelFetch(standing, there, 0).rgb);
    }
    return light;
}

void main() {
    ivec2 size = textureSize(clear_scene, 0), at = ivec2(gl_FragCoord.x, float(screen.y) - gl_FragCoord.y);
    at = min(at * size / screen, size - 1);
    vec2 share = texelFetch(shares, at, 0).rg;
    vec4 picture = with_rain(texelFetch(clear_scene, at, 0), share.r, share.g, rain_light);
    if (mirror_size.y > 0) picture.rgb = linear_to_srgb(srgb_to_linear(picture.rgb) + reflected(at));
    color = vec4(clamp(picture.rgb, 0.0, 1.0), 1.0);
}
