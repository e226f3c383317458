#version 430
// One fragment of a splat, premultiplied. Where rain mixes in linear light (LINEAR_RAIN), the scene and the rain are
// kept apart: `fragment` gathers the scene alone, as if it were clear, and `shares` how much of each the eye sees
// through the other. rain_resolve.frag puts them together.

#include "common_splat.glsl"

in vec2 deviations;
flat in vec4 color_alpha;
flat in float view_depth;
flat in int is_rain;

layout(location = 0) out vec4 fragment;
#ifdef LINEAR_RAIN
layout(location = 1) out vec4 shares;          // red: rain, green: scene
#endif
#ifdef WITH_DEPTH
layout(location = 2) out vec4 weighted_depth;  // of the scene: rain has no part in it
#endif

void main() {
    float alpha = min(MAX_ALPHA, color_alpha.a * exp(-0.5 * dot(deviations, deviations)));
    if (alpha < (is_rain != 0 ? RAIN_ALPHA_CUT : SCENE_ALPHA_CUT)) discard;
    float scene_alpha = is_rain != 0 ? 0.0 : alpha;
#ifdef LINEAR_RAIN
    fragment = vec4(color_alpha.rgb * scene_alpha, scene_alpha);
    shares = vec4(alpha - scene_alpha, scene_alpha, 0.0, alpha);
#else
    fragment = vec4(color_alpha.rgb * alpha, alpha);
#endif
#ifdef WITH_DEPTH
    weighted_depth = vec4(view_depth * scene_alpha, scene_alpha, 0.0, scene_alpha);
#endif
}
