#version 300 es
// One fragment of a page's splat, premultiplied; rain and scene apart, as in splat.frag with LINEAR_RAIN.

precision highp float;

#include "common_alpha.glsl"

in vec2 offset;
flat in vec4 color_log_alpha;
flat in vec2 more;
flat in int is_rain;

layout(location = 0) out vec4 fragment;
layout(location = 1) out vec4 shares;  // red: rain, green: scene
layout(location = 2) out vec4 visible; // water, or depth, of the scene

void main() {
    float alpha = min(MAX_ALPHA, exp2(color_log_alpha.a - dot(offset, offset)));
    if (alpha < (is_rain != 0 ? RAIN_ALPHA_CUT : SCENE_ALPHA_CUT)) discard;
    float scene_alpha = is_rain != 0 ? 0.0 : alpha;
    fragment = vec4(color_log_alpha.rgb * scene_alpha, scene_alpha);
    visible = vec4(scene_alpha * more, 0.0, scene_alpha);
    shares = vec4(alpha - scene_alpha, scene_alpha, 0.0, alpha);
}
