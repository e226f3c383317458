#version 300 es
// Light that facets of a page's water reflect, which tilt along the line of sight: along the columns of its mirror image, as
// _blur_columns of gsrain_engine/water/mirror.py.

precision highp float;
precision highp sampler2D;

#include "common_page_mirror.glsl"

uniform sampler2D light;   // as page_mirror_light.frag writes it
uniform sampler2D facets;  // share of light, mean and deviation of tilt, by angle; rows: films, and standing water in each rain
uniform int standing_row;

layout(location = 0) out vec4 films;
layout(location = 1) out vec4 standing;

const float FOOTPRINT = 0.4;  // px

vec3 facet(float sine, int row) {
    int last = textureSize(facets, 0).x - 1;
    float at = sqrt(clamp(sine, 0.0, 1.0)) * float(last);
    int k = min(int(at), last - 1);
    return mix(texelFetch(facets, ivec2(k, row), 0).rgb, texelFetch(facets, ivec2(k + 1, row), 0).rgb, at - float(k));
}

vec4 reflected(ivec2 pixel, int row) {
    vec3 ray = ray_of(pixel), water = facet(sine_to_ground(ray), row);
    float scale = 2.0 * intrinsics.y * (1.0 + ray.y * ray.y), mean = scale * water.y, spread = scale * water.z;
    float reach = 4.0 * (spread + FOOTPRINT) + 1.0;
    int first = max(0, int(float(pixel.y) - reach)), last = min(mirror_size.y, int(float(pixel.y) + mean + reach) + 1);
    vec4 sum = vec4(0.0);
    for (int row_there = first; row_there < last; ++row_there) {
        vec4 there = texelFetch(light, ivec2(pixel.x, row_there), 0);
        if (there.a < 0.0) continue;
        float away = float(row_there - pixel.y) - mean * there.a;
        float per_variance = 1.0 / (spread * spread * there.a * there.a + FOOTPRINT * FOOTPRINT);
        float near = max(1.0 - away * away * per_variance / 16.0, 0.0);
        near *= near;
        near *= near;
        sum += near * near * sqrt(per_variance) * vec4(there.rgb, 1.0);
    }
    return vec4(water.x / max(sum.a, 1e-12) * sum.rgb, 1.0);
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    films = standing = vec4(0.0);
    if (texelFetch(light, pixel, 0).a < 0.0) return;
    films = reflected(pixel, 0);
    standing = reflected(pixel, standing_row);
}
