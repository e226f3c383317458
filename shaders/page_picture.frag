#version 300 es
// Adds the rain's light to the scene's and shows the picture, whose first row is the uppermost.

precision highp float;

#include "common_srgb.glsl"
#include "common_rain_light.glsl"

uniform sampler2D clear_scene, shares;
uniform vec3 rain_light;
uniform ivec2 screen;   // px of the canvas

out vec4 color;

void main() {
    ivec2 size = textureSize(clear_scene, 0), at = ivec2(gl_FragCoord.x, float(screen.y) - gl_FragCoord.y);
    at = min(at * size / screen, size - 1);
    vec2 share = texelFetch(shares, at, 0).rg;
    vec4 picture = with_rain(texelFetch(clear_scene, at, 0), share.r, share.g, rain_light);
    color = vec4(clamp(picture.rgb, 0.0, 1.0), 1.0);
}
