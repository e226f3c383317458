#version 430
// Airlight of the medium behind the scene, the layer on which splat.frag blends.

#include "common_srgb.glsl"
#include "common_medium.glsl"

uniform vec4 intrinsics;  // fx fy cx cy (px)

layout(location = 0) out vec4 fragment;
#ifdef LINEAR_RAIN
layout(location = 1) out vec4 shares;
#endif
#ifdef WITH_DEPTH
layout(location = 2) out vec4 weighted_depth;
#endif
#ifdef LAMPS
layout(location = 3) out vec4 lamp_light;
#endif

void main() {
    fragment = medium_sky(gl_FragCoord.xy, intrinsics);
#ifdef LINEAR_RAIN
    shares = vec4(0.0, fragment.a, 0.0, 0.0);
#endif
#ifdef WITH_DEPTH
    weighted_depth = vec4(0.0);
#endif
#ifdef LAMPS
    lamp_light = vec4(0.0);
#endif
}
