#version 430
// One fragment of a splat, premultiplied. If rain mixes in linear light (LINEAR_RAIN), the scene and the rain are
// accumulated separately: `fragment` holds the clear scene, and `shares` the visible share of each through the
// other. rain_resolve.frag puts them together. No races: OpenGL blends fragments of a pixel in the order of their quads.

#include "common_alpha.glsl"

in vec2 offset;
flat in vec4 color_log_alpha;
flat in float view_depth;
flat in int is_rain;

layout(location = 0) out vec4 fragment;
#ifdef LINEAR_RAIN
layout(location = 1) out vec4 shares;          // red: rain, green: scene
#endif
#ifdef WITH_DEPTH
layout(location = 2) out vec4 weighted_depth;  // of the scene: rain has no part in it
#endif
#ifdef LAMPS
layout(location = 3) out vec4 lamp_light;      // of the rain, in linear light: the color of its splats
#endif

void main() {
    float exponent = dot(offset, offset);
#ifdef ELLIPSOIDS
    float height = 1.0 - exponent / (color_log_alpha.a - log2(SURFACE_ALPHA));
    if (!(height >= 0.0)) discard;
    fragment = vec4(color_log_alpha.rgb * (0.5 + 0.5 * sqrt(height)), 1.0);
    return;
#endif
    float alpha = min(MAX_ALPHA, exp2(color_log_alpha.a - exponent));
    if (alpha < (is_rain != 0 ? RAIN_ALPHA_CUT : SCENE_ALPHA_CUT)) alpha = 0.0;  // on llvmpipe faster than discard
#ifdef OVERDRAW
    fragment = vec4(alpha > 0.0 ? 1.0 : 0.0);
    return;
#endif
    float scene_alpha = is_rain != 0 ? 0.0 : alpha;
#ifdef LINEAR_RAIN
    fragment = vec4(color_log_alpha.rgb * scene_alpha, scene_alpha);
    shares = vec4(alpha - scene_alpha, scene_alpha, 0.0, alpha);
#else
    fragment = vec4(color_log_alpha.rgb * alpha, alpha);
#endif
#ifdef WITH_DEPTH
    weighted_depth = vec4(view_depth * scene_alpha, scene_alpha, 0.0, scene_alpha);
#ifdef LAMPS
    weighted_depth.z = view_depth / (view_depth + 16.0) * scene_alpha;  // as share_of_depth in lamp_light.py
#endif
#endif
#ifdef LAMPS
    lamp_light = vec4(color_log_alpha.rgb * (alpha - scene_alpha), alpha);
#endif
}
