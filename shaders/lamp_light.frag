#version 430
// Adds the light of lamps to a picture: that of drops drawn one by one, and that which the medium scatters into each ray (Sun
// et al. 2005). gsrain_engine/rain/lamp_light.py is the readable form.

#include "common_srgb.glsl"
#include "common_medium.glsl"
#include "common_lamps.glsl"

uniform sampler2D picture;     // premultiplied display color
uniform sampler2D drop_light;  // linear
uniform sampler2D depths;      // of the scene alone: green the weight, blue weighted shares of depth
uniform sampler3D lamp_table;  // linear light up to each slice, at the corners of cells: slices, columns, rows
uniform float cell_px;
uniform vec4 intrinsics;       // fx fy cx cy (px)

out vec4 fragment;

const float QUARTER = 1.57079632679490, STEP = QUARTER / 4.0, NO_WEIGHT = 1e-3, OPAQUE = 0.98;
const float SLICES = 24.0, SLICE_SCALE = 16.0, FAR = 1e6, REACH = 2.5, UNSEEN = 0.01;

// Light of lamp i, over its intensity, scattered along a ray up to a distance; `b` as its distance from the ray.
float up_to(int i, vec3 ray, float distance_m, vec3 center, float nearest, float b) {
    vec3 axis = lamp_vector(i, 3);
    float along = dot(axis, ray), across = (nearest * along - dot(axis, center)) / b;
    float largest = sqrt(along * along + across * across), ends = lamp(i, 9), full = lamp(i, 10);
    float ratio = ends / max(largest, 1e-9), longest = STEP;
    float first = atan(-nearest, b), last = atan(distance_m - nearest, b);
    if (ratio >= 1.0) return 0.0;
    if (ratio > 0.0) {
        float middle = atan(along, across), extent = acos(ratio);
        first = max(first, middle - extent);
        last = min(last, middle + extent);
        longest = min(STEP, extent / 3.0);
    }
    if (first >= last) return 0.0;
    int steps = int(ceil((last - first) / longest));
    float total = 0.0, start = clamp(nearest + b * tan(first), 0.0, distance_m), angle = first;
    float depth = start > 0.0 ? medium_depth(start * ray) : 0.0, sum = lamp_scattering(first + QUARTER, 0);
    for (int k = 1; k <= steps; ++k) {
        float next_angle = first + (last - first) * float(k) / float(steps);
        float next = k == steps ? min(max(nearest + b * tan(last), start), distance_m)
                                : clamp(nearest + b * tan(next_angle), start, distance_m);
        float next_depth = next > 0.0 ? medium_depth(next * ray) : 0.0;
        float next_sum = lamp_scattering(next_angle + QUARTER, 0);
        float per_m = (next_depth - depth) / max(next - start, 1e-9);
        float at = clamp(nearest + b * tan(0.5 * (angle + next_angle)), start, next), offset = at - nearest;
        vec3 v = at * ray - center;
        float length_m = sqrt(b * b + offset * offset), ahead = offset / length_m, aside = b / length_m;
        float turned = 0.3872983 * (next_angle - angle);
        float one = along * ahead + across * aside, other = along * aside - across * ahead;
        float lit = 8.0 / 18.0 * lamp_cone(one, ends, full)
            + 5.0 / 18.0 * (lamp_cone(cos(turned) * one + sin(turned) * other, ends, full)
                            + lamp_cone(cos(turned) * one - sin(turned) * other, ends, full));
        if (lit > 0.0 && per_m > 0.0) {
            float dimmed = exp(-(depth + per_m * (at - start) + lamp_depth(v, length_m, i)));
            total += per_m * dimmed * lit * (next_sum - sum) / (8.0 * QUARTER * b);
        }
        angle = next_angle;
        start = next;
        depth = next_depth;
        sum = next_sum;
    }
    return total;
}

vec3 looked_up(vec3 at) {
    ivec3 size = textureSize(lamp_table, 0), corner = clamp(ivec3(at), ivec3(0), size - 2);
    vec3 share = at - vec3(corner), light = vec3(0.0);
    for (int k = 0; k < 8; ++k) {
        ivec3 step_to = ivec3(k & 1, (k >> 1) & 1, k >> 2);
        vec3 weight = mix(1.0 - share, share, vec3(step_to));
        light += weight.x * weight.y * weight.z * texelFetch(lamp_table, corner + step_to, 0).rgb;
    }
    return light;
}

vec3 scattered_light(vec2 point, float distance_m) {
    vec3 light = looked_up(vec3(distance_m / (distance_m + SLICE_SCALE) * SLICES, point / cell_px));
    vec3 ray = normalize(vec3((point - intrinsics.zw) / intrinsics.xy, 1.0));
    float unseen = UNSEEN * max(light.x, max(light.y, light.z));
    float bound = medium_numbers[0] * lamp_scattering(2.0 * QUARTER, 0) / (8.0 * QUARTER);
    for (int i = 0; i < lamp_count; ++i) {
        vec3 center = lamp_vector(i, 0);
        float nearest = dot(ray, center), away = lamp(i, 17), base = lamp(i, 11);
        if (nearest <= 0.0) continue;
        float square = max(away * away - nearest * nearest, 0.0);
        float reach = square / (REACH * REACH * base * base);
        if (reach >= 1.0) continue;
        float b = max(sqrt(square), lamp(i, 12)), soft = sqrt(sqrt(square * square + base * base * base * base));
        float at_most = lamp(i, 16) * bound * (1.0 / b - 1.0 / soft);
        if (at_most < unseen) {
            unseen -= at_most;
            continue;
        }
        float rest = up_to(i, ray, distance_m, center, nearest, b) - up_to(i, ray, distance_m, center, nearest, soft);
        light += rest * smoothstep(0.0, 1.0, 4.0 * (1.0 - reach)) * lamp_vector(i, 6);
    }
    return max(light, 0.0);
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    fragment = texelFetch(picture, pixel, 0);
    vec3 light = texelFetch(drop_light, pixel, 0).rgb;
#ifdef MEDIUM
    vec2 depth = texelFetch(depths, pixel, 0).gb;
    float share = depth.x > OPAQUE ? 1.0 : max(depth.x, 0.0);
    if (share > NO_WEIGHT) {
        float mean = min(depth.y / depth.x, 1.0 - 1e-6);
        float slope = length(vec3((gl_FragCoord.xy - intrinsics.zw) / intrinsics.xy, 1.0));
        light += share * scattered_light(gl_FragCoord.xy, min(slope * SLICE_SCALE * mean / (1.0 - mean), FAR));
    }
    if (share < 1.0) light += (1.0 - share) * scattered_light(gl_FragCoord.xy, FAR);
#endif
    fragment.rgb = mix(fragment.rgb, linear_to_srgb(srgb_to_linear(fragment.rgb) + light), greaterThan(light, vec3(0.0)));
}
