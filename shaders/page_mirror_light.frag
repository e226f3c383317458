#version 300 es
// Linear light of what the mirrored camera of a page sees, and the share of the way to it beyond the ground: below 0 where a
// ray misses the ground.

precision highp float;
precision highp sampler2D;

#include "common_srgb.glsl"
#include "common_page_mirror.glsl"

uniform sampler2D picture, depths;  // of the mirrored camera, whose first row is the lowest; depth (m) times alpha, and alpha
uniform vec3 sky;                   // display color
uniform float above;                // height of the camera over the ground (m)

out vec4 light;

const float MIN_WEIGHT = 0.5;  // least alpha of a depth

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy), at = ivec2(pixel.x, mirror_size.y - 1 - pixel.y);
    vec4 color = texelFetch(picture, at, 0), depth = texelFetch(depths, at, 0);
    vec3 ray = ray_of(pixel);
    float sine = sine_to_ground(ray), beyond = -1.0;
    if (sine > MIN_SINE) {
        beyond = depth.a >= MIN_WEIGHT ? clamp(1.0 - above / (sine * length(ray) * depth.r / depth.a), 0.0, 1.0) : 1.0;
    }
    light = vec4(srgb_to_linear(color.rgb + (1.0 - color.a) * sky), beyond);
}
