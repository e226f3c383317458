#version 430
// Converts the premultiplied image for the screen: background, display gain, clamp.

#include "common_srgb.glsl"

uniform sampler2D picture;
uniform vec3 background;  // display color
uniform float gain;       // multiplies linear light; 1 leaves display values as they are

out vec4 fragment;

void main() {
    vec4 texel = texelFetch(picture, ivec2(gl_FragCoord.xy), 0);
    vec3 color = texel.rgb + (1.0 - texel.a) * background;
    if (gain != 1.0) color = linear_to_srgb(gain * srgb_to_linear(color));
    fragment = vec4(clamp(color, 0.0, 1.0), 1.0);
}
