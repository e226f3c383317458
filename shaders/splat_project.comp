#version 430
// Projects each Gaussian once: cull, 2D covariance, exact extent, colour. One thread a Gaussian.
// Zwicker et al. 2002 (EWA splatting) as used by Kerbl et al. 2023; limits for off-centre cameras as in gsplat.

layout(local_size_x = 256) in;

#include "common_splat.glsl"
#include "common_spherical_harmonics.glsl"

layout(std430, binding = 0) readonly buffer Means { vec4 means_opacities[]; };
layout(std430, binding = 1) readonly buffer Scales { vec4 scales[]; };
layout(std430, binding = 2) readonly buffer Rotations { vec4 quaternions[]; };  // w x y z
layout(std430, binding = 3) readonly buffer Harmonics { float harmonics[]; };   // K * 3 a Gaussian
layout(std430, binding = 4) writeonly buffer Splats { Splat splats[]; };
layout(std430, binding = 5) writeonly buffer Depths { uint depth_keys[]; };

uniform int count;
uniform int first_splat;          // where this chunk's splats start
uniform int coefficients;         // spherical harmonics a colour: 1, 4, 9, 16
uniform mat4 object_to_camera;    // may hold a uniform scale
uniform vec3 camera_in_object;    // centre of projection in the Gaussians' own frame
uniform vec4 intrinsics;          // fx fy cx cy (px)
uniform vec2 image_size;          // px
uniform float near;               // m
uniform bool is_rain;

const float DILATION = 0.3;       // px^2, added to the 2D covariance: the pixel's own footprint

mat3 rotation_matrix(vec4 q) {    // columns are the Gaussian's axes
    float w = q.x, x = q.y, y = q.z, z = q.w;
    return mat3(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

vec3 display_color(int i, vec3 mean) {
    vec3 direction = normalize(mean - camera_in_object);
    vec3 color = vec3(0.5);
    int base = i * coefficients * 3;
    for (int k = 0; k < coefficients; ++k) {
        int at = base + 3 * k;
        color += sh_basis(k, direction) * vec3(harmonics[at], harmonics[at + 1], harmonics[at + 2]);
    }
    return max(color, 0.0);
}

void main() {
    int i = int(gl_GlobalInvocationID.x);
    if (i >= count) return;
    int target = first_splat + i;
    depth_keys[target] = CULLED;

    vec4 mean_opacity = means_opacities[i];
    vec3 p = (object_to_camera * vec4(mean_opacity.xyz, 1.0)).xyz;
    if (!(p.z > near)) return;  // also drops NaN

    // Local affine approximation of the projection, held back at 1.3 times the field of view.
    vec2 f = intrinsics.xy, c = intrinsics.zw;
    vec2 margin = 0.15 * image_size / f;
    vec2 slope = clamp(p.xy / p.z, -c / f - margin, (image_size - c) / f + margin);
    vec3 rx = vec3(f.x / p.z, 0.0, -f.x * slope.x / p.z);
    vec3 ry = vec3(0.0, f.y / p.z, -f.y * slope.y / p.z);

    mat3 axes = mat3(object_to_camera) * rotation_matrix(quaternions[i]);
    vec3 s = scales[i].xyz;
    vec3 ux = (rx * axes) * s, uy = (ry * axes) * s;  // rows of J W R S
    float a = dot(ux, ux), b = dot(ux, uy), d = dot(uy, uy);

    float opacity = mean_opacity.w;
    float cut = is_rain ? RAIN_ALPHA_CUT : SCENE_ALPHA_CUT;
    float before = max(a * d - b * b, 0.0);
    a += DILATION;
    d += DILATION;
    float determinant = a * d - b * b;
    if (is_rain) opacity *= sqrt(before / determinant);  // keeps the integral of alpha (Yu et al. 2024)
    if (!(opacity > cut) || isinf(determinant)) return;
    float extent = sqrt(2.0 * log(opacity / cut));       // exact: alpha is the cut at the edge

    float middle = 0.5 * (a + d);
    float spread = length(vec2(0.5 * (a - d), b));
    float large = middle + spread;
    float small = max(determinant / large, 1e-6);
    vec2 axis = abs(b) > 1e-9 * large ? normalize(vec2(b, large - a)) : (a >= d ? vec2(1, 0) : vec2(0, 1));
    vec2 first = sqrt(large) * axis, second = sqrt(small) * vec2(-axis.y, axis.x);

    vec2 center = f * p.xy / p.z + c;
    vec2 reach = extent * sqrt(vec2(a, d));
    if (any(lessThan(center + reach, vec2(0))) || any(greaterThan(center - reach, image_size))) return;

    depth_keys[target] = floatBitsToUint(p.z);
    splats[target] = Splat(
        vec4(center, first), vec4(second, opacity, is_rain ? -extent : extent),
        vec4(display_color(i, mean_opacity.xyz), p.z));
}
