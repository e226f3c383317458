#version 430
// Adds the rain's light to the scene's.

#include "common_srgb.glsl"
#include "common_rain_light.glsl"

uniform sampler2D clear_scene;  // premultiplied display color
uniform sampler2D shares;       // red: rain, green: scene
uniform vec3 rain_light;        // S, a drop's color in linear light

out vec4 fragment;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec2 share = texelFetch(shares, pixel, 0).rg;
    fragment = with_rain(texelFetch(clear_scene, pixel, 0), share.r, share.g, rain_light);
}
