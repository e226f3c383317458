#version 410
// Converts the premultiplied image for the screen: sharpening, background, display gain, clamp.

#include "common_srgb.glsl"

uniform sampler2D picture;
uniform vec3 background;  // display color
uniform float gain;       // multiplies linear light; 1 leaves display values as they are
uniform float sharpness;  // factor on the difference from the four neighbors, for images that the display enlarges

out vec4 fragment;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 texel = texelFetch(picture, at, 0);
    if (sharpness > 0.0) {
        ivec2 last = textureSize(picture, 0) - 1;
        vec4 around = texelFetch(picture, ivec2(max(at.x - 1, 0), at.y), 0);
        around += texelFetch(picture, ivec2(min(at.x + 1, last.x), at.y), 0);
        around += texelFetch(picture, ivec2(at.x, max(at.y - 1, 0)), 0);
        around += texelFetch(picture, ivec2(at.x, min(at.y + 1, last.y)), 0);
        texel += sharpness * (texel - 0.25 * around);
    }
    vec3 color = texel.rgb + (1.0 - texel.a) * background;
    if (gain != 1.0) color = linear_to_srgb(gain * srgb_to_linear(color));
    fragment = vec4(clamp(color, 0.0, 1.0), 1.0);
}
