#version 300 es
// Projects each Gaussian of a page's scene, or each streak (STREAKS): a fragment of a data texture for each. WebGL has no
// compute shaders; common_ellipse.glsl is the same as on the desktop. The scene's numbers are those of a SOG file.

precision highp float;
precision highp int;
precision highp sampler2D;

#include "common_ellipse.glsl"

layout(location = 0) out uvec4 shape;  // of a splat: center and first axis
layout(location = 1) out uvec4 rest;   // second axis, depth and appearance

uniform int first_row, count;

#ifdef STREAKS
uniform sampler2D streaks;   // three texels each: center, opacity; direction, sigma along; sigma across, and in a third direction
uniform mat4 moved;          // from the frame of the camera that they were made for
uniform vec3 display_color;
#else
#include "common_spherical_harmonics.glsl"
#include "common_srgb.glsl"
#include "common_medium.glsl"
uniform sampler2D means, scales, quaternions, base, labels, centroids, wet_base, wet_labels, wet_centroids;
uniform sampler2D codebooks;  // 256 columns; rows: scales, base, others, and base and others of the wet colors
uniform int coefficients, wet_coefficients;
uniform mat4 object_to_camera;
uniform float wetness;
uniform bool antialiased, has_medium, has_actors;
uniform sampler2D actors;  // number of each Gaussian's actor
uniform sampler2D poses;   // a row for each actor: three rows of its matrix, and the height of uneven ground below it; 0 does not move

// In a mirror, some Gaussians are left out, the others larger, and what is over uneven ground is moved to a level one.
uniform bool is_mirrored, is_uneven;
uniform highp usampler2D reflected;  // numbers of those in it, and in the upper 8 bits 1 and in steps how much larger they are
uniform sampler2D floors;  // height of uneven ground below each Gaussian that does not move (m)
uniform vec4 level;        // upward in the object's frame, and the height of level ground (m)
uniform float growth_steps;

vec3 looked_up(vec3 bytes, int row) {
    ivec3 at = ivec3(255.0 * bytes + 0.5);
    return vec3(
        texelFetch(codebooks, ivec2(at.r, row), 0).r, texelFetch(codebooks, ivec2(at.g, row), 0).r,
        texelFetch(codebooks, ivec2(at.b, row), 0).r);
}

vec3 color_of(
    ivec2 at, vec3 direction, sampler2D first, sampler2D names, sampler2D palette, int harmonics, int row
) {
    vec3 color = 0.5 + sh_basis(0, direction) * looked_up(texelFetch(first, at, 0).rgb, row);
    if (harmonics > 1) {
        ivec2 name = ivec2(255.0 * texelFetch(names, at, 0).rg + 0.5);
        int label = name.x + 256 * name.y;
        for (int k = 1; k < harmonics; ++k) {
            ivec2 entry = ivec2((label & 63) * (harmonics - 1) + k - 1, label >> 6);
            color += sh_basis(k, direction) * looked_up(texelFetch(palette, entry, 0).rgb, row + 1);
        }
    }
    return color;
}

mat3 rotation_matrix(vec4 q) {
    float w = q.x, x = q.y, y = q.z, z = q.w;
    return mat3(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

vec4 quaternion(vec4 texel) {  // the largest number is left out; alpha tells which of w x y z it is
    vec3 others = (texel.rgb * 2.0 - 1.0) * 0.70710678118654752;
    float largest = sqrt(max(1.0 - dot(others, others), 0.0));
    int which = int(255.0 * texel.a + 0.5) - 252;
    if (which == 0) return vec4(largest, others);
    if (which == 1) return vec4(others.x, largest, others.yz);
    if (which == 2) return vec4(others.xy, largest, others.z);
    return vec4(others, largest);
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    int number = (pixel.y - first_row) * SPLAT_COLUMNS + pixel.x;
    shape = uvec4(0u);
    rest = uvec4(0u);
    if (number >= count) return;
    Splat splat;
#ifdef STREAKS
    ivec2 at = ivec2(3 * (number % STREAK_COLUMNS), number / STREAK_COLUMNS);
    vec4 place = texelFetch(streaks, at, 0), direction = texelFetch(streaks, at + ivec2(1, 0), 0);
    vec4 sideways = texelFetch(streaks, at + ivec2(2, 0), 0);
    float opacity = place.w;
    place = moved * vec4(place.xyz, 1.0);
    direction.xyz = mat3(moved) * direction.xyz;
    vec3 side = mat3(moved) * sideways.yzw;
    if (dot(side, side) == 0.0) {
        side = abs(direction.x) < 0.7 ? cross(direction.xyz, vec3(1, 0, 0)) : cross(direction.xyz, vec3(0, 1, 0));
        side *= sideways.x / length(side);
    }
    mat3 axes = mat3(side, sideways.x * cross(direction.xyz, normalize(side)), direction.w * direction.xyz);
    if (!project(place.xyz, axes, opacity, true, false, false, splat)) return;
    set_color(splat, display_color);
#else
    ivec2 own = ivec2(number % SPLAT_COLUMNS, number / SPLAT_COLUMNS);
    float growth = 1.0;
    if (is_mirrored) {
        uint code = texelFetch(reflected, own, 0).r;
        growth += (float(code >> 24) - 1.0) / growth_steps;
        number = int(code & 0xFFFFFFu);
        own = ivec2(number % SPLAT_COLUMNS, number / SPLAT_COLUMNS);
    }
    ivec2 size = textureSize(base, 0), at = ivec2(number % size.x, number / size.x);
    vec3 mean = texelFetch(means, own, 0).xyz;
    mat4 to_camera = object_to_camera;
    int actor = 0;
    if (has_actors) {
        ivec2 label = ivec2(255.0 * texelFetch(actors, own, 0).rg + 0.5);
        actor = label.x + 256 * label.y;
        if (actor > 0) {
            mat4 pose;
            for (int row = 0; row < 3; ++row) pose[row] = texelFetch(poses, ivec2(row, actor), 0);
            pose[3] = vec4(0.0, 0.0, 0.0, 1.0);
            to_camera = object_to_camera * transpose(pose);
        }
    }
    vec3 p = (to_camera * vec4(mean, 1.0)).xyz;
    if (is_mirrored && is_uneven) {
        float floor_m = actor > 0 ? texelFetch(poses, ivec2(3, actor), 0).r : texelFetch(floors, own, 0).r;
        p += (level.w - floor_m) * (mat3(object_to_camera) * level.xyz);
    }
    if (!(p.z > near)) return;  // also where it is absent
    mat3 axes = mat3(to_camera) * rotation_matrix(quaternion(texelFetch(quaternions, at, 0)));
    vec3 s = exp(looked_up(texelFetch(scales, at, 0).rgb, 0)) * growth;
    axes = mat3(axes[0] * s.x, axes[1] * s.y, axes[2] * s.z);
    if (!project(p, axes, texelFetch(base, at, 0).a, false, false, antialiased, splat)) return;
    vec3 direction = normalize(transpose(mat3(to_camera)) * p);
    vec3 color = color_of(at, direction, base, labels, centroids, coefficients, 1);
    if (wetness > 0.0) {
        vec3 wet = color_of(at, direction, wet_base, wet_labels, wet_centroids, wet_coefficients, 3);
        color = (1.0 - wetness) * color + wetness * wet;
    }
    color = max(color, 0.0);
    if (has_medium) {
        float kept = medium_transmittance(p);
        color = linear_to_srgb(kept * srgb_to_linear(color) + (1.0 - kept) * airlight);
    }
    set_color(splat, color);
#endif
    shape = uvec4(floatBitsToUint(splat.center), floatBitsToUint(splat.first_axis));
    rest = uvec4(floatBitsToUint(splat.second), floatBitsToUint(splat.depth), splat.appearance);
}
