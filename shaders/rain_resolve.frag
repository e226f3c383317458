#version 430
// Adds the rain's light to the scene's in linear space (docs/physics.md, section 6).
// For one streak of alpha a before a scene of display color B this is enc((1 - a) dec(B) + a S).

#include "common_srgb.glsl"

uniform sampler2D clear_scene;  // premultiplied display color
uniform sampler2D shares;       // red: rain, green: scene
uniform vec3 rain_light;        // S, a drop's color in linear light

out vec4 fragment;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 scene = texelFetch(clear_scene, pixel, 0);
    vec2 share = texelFetch(shares, pixel, 0).rg;
    if (share.r <= 0.0) {
        fragment = scene;
        return;
    }
    float transmittance = scene.a > 0.0 ? min(share.g / scene.a, 1.0) : 1.0;
    vec3 light = transmittance * srgb_to_linear(scene.rgb) + share.r * rain_light;
    fragment = vec4(linear_to_srgb(light), share.r + share.g);
}
