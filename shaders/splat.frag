#version 430
// One fragment of a splat, premultiplied. Rain adds its light in linear space (LINEAR_RAIN) over the clear scene.

#include "common_splat.glsl"
#include "common_srgb.glsl"

in vec2 deviations;
flat in vec4 color_alpha;
flat in float view_depth;
flat in int is_rain;

layout(location = 0) out vec4 fragment;
#ifdef WITH_DEPTH
layout(location = 1) out vec4 weighted_depth;
#endif
#ifdef LINEAR_RAIN
uniform sampler2D clear_scene;  // the same view without rain, premultiplied
uniform vec3 rain_light;        // a drop's colour in linear light
#endif

void main() {
    float alpha = min(MAX_ALPHA, color_alpha.a * exp(-0.5 * dot(deviations, deviations)));
    if (alpha < (is_rain != 0 ? RAIN_ALPHA_CUT : SCENE_ALPHA_CUT)) discard;
    fragment = vec4(color_alpha.rgb * alpha, alpha);
#ifdef LINEAR_RAIN
    if (is_rain != 0) {
        vec3 behind = texelFetch(clear_scene, ivec2(gl_FragCoord.xy), 0).rgb;
        vec3 mixed = linear_to_srgb((1.0 - alpha) * srgb_to_linear(behind) + alpha * rain_light);
        fragment.rgb = mixed - (1.0 - alpha) * behind;
    }
#endif
#ifdef WITH_DEPTH
    weighted_depth = vec4(view_depth * alpha, 0.0, 0.0, alpha);
#endif
}
