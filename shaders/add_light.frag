#version 430
// Adds linear light to a picture, such as that which wet ground reflects. gsrain_engine/water/mirror.py is its source.

#include "common_srgb.glsl"

uniform sampler2D picture;  // premultiplied display color
uniform sampler2D light;    // linear

out vec4 fragment;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 before = texelFetch(picture, pixel, 0);
    vec3 added = texelFetch(light, pixel, 0).rgb;
    vec3 after = linear_to_srgb(srgb_to_linear(before.rgb) + added);
    fragment = vec4(mix(before.rgb, after, greaterThan(added, vec3(0.0))), before.a);
}
