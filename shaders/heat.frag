#version 430
// Maps one number per pixel to a heat color: overdraw, or (DEPTH) the logarithm of the expected depth. Empty stays empty.

#include "common_heat.glsl"

uniform sampler2D numbers;
uniform vec2 ends;  // numbers of the first and the last color

out vec4 fragment;

void main() {
    vec4 texel = texelFetch(numbers, ivec2(gl_FragCoord.xy), 0);
#ifdef DEPTH
    float there = texel.g > 0.5 ? 1.0 : 0.0;
    float t = log(max(texel.r / max(texel.g, 0.5), 1e-9) / ends.x) / log(ends.y / ends.x);
#else
    float there = texel.r > 0.0 ? 1.0 : 0.0;
    float t = (texel.r - ends.x) / (ends.y - ends.x);
#endif
    fragment = vec4(there * heat_color(t), there);
}
