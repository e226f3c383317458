#version 300 es
// Airlight of a page's medium behind the scene, as medium_sky.frag.

precision highp float;
precision highp int;

#include "common_srgb.glsl"
#include "common_medium.glsl"

uniform vec4 intrinsics;

layout(location = 0) out vec4 fragment;
layout(location = 1) out vec4 shares;
layout(location = 2) out vec4 visible;

void main() {
    fragment = medium_sky(gl_FragCoord.xy, intrinsics);
    shares = vec4(0.0, fragment.a, 0.0, 0.0);
    visible = vec4(0.0);
}
