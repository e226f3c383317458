#version 430
// Shows a number a pixel as a heat colour: overdraw, or (DEPTH) expected depth by its logarithm. Nothing stays nothing.

#include "common_heat.glsl"

uniform sampler2D numbers;
uniform vec2 ends;  // what the first and the last colour stand for

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
