#version 430
// Projects each Gaussian of a chunk once. One thread per Gaussian.
// No races: only `emit` shares data, every thread calls it once, and each workgroup of each dispatch has its own block.

layout(local_size_x = 256) in;

#include "common_projection.glsl"
#include "common_spherical_harmonics.glsl"
#include "common_heat.glsl"
#include "common_tint.glsl"
#ifdef MEDIUM
#include "common_srgb.glsl"
#include "common_medium.glsl"
uniform bool is_linear;           // the medium changes linear light, else display values
#endif

layout(std430, binding = 0) readonly buffer Means { vec4 means_opacities[]; };
layout(std430, binding = 1) readonly buffer Scales { float scales[]; };         // 3 a Gaussian
layout(std430, binding = 2) readonly buffer Rotations { vec4 quaternions[]; };  // w x y z
#if SH_BITS == 16
#define STORED uvec2  // fewer, wider loads: harmonics are most of what this shader reads
#else
#define STORED uint
#endif
layout(std430, binding = 3) readonly buffer Harmonics { STORED harmonics[]; };    // as SH_BITS says
#ifdef WET
layout(std430, binding = 12) readonly buffer WetHarmonics { STORED wet_harmonics[]; };  // when soaked, in the same storage
#endif
#ifdef MEMBERS
layout(std430, binding = 6) readonly buffer Members { uint members[]; };  // numbers; in the highest bit: selected
uniform uint first_member;        // of this chunk
const uint IN_CHUNK = (1u << 19) - 1u;
#else
layout(std430, binding = 6) readonly buffer Marks { uvec2 marks[]; };     // bits of 32 Gaussians: left out, selected
uniform bool has_marks;
#endif

uniform uint count;
uniform int coefficients;         // spherical harmonics a color: 1, 4, 9, 16
uniform mat4 object_to_camera;    // may hold a uniform scale
uniform vec3 camera_in_object;    // centre of projection in the Gaussians' own frame
#ifdef LENS
uniform vec3 camera_changes[2];   // of it by the part s of the readout: + s first + s^2 second
#endif
uniform mat3 camera_to_world;
uniform vec3 layer_color;
uniform bool is_rain;
uniform bool antialiased;         // as Gaussians.antialiased
uniform float growth;             // of each Gaussian, where others are left out
uniform float layer_opacity;      // multiplies each Gaussian's own
uniform mat4x3 color_change;      // of display colors, affine
#ifdef WET
uniform float wetness;            // 0 clear, 1 soaked; above 0 only where there are wet harmonics
#endif
uniform int look;                 // 0 the picture, else LOOK_*

const int LOOK_POINTS = 1, LOOK_NORMALS = 2, LOOK_OPACITY = 3, LOOK_LAYERS = 4;

mat3 rotation_matrix(vec4 q) {    // columns are the Gaussian's axes
    float w = q.x, x = q.y, y = q.z, z = q.w;
    return mat3(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

STORED stored(uint at, bool wet) {
#ifdef WET
    if (wet) return wet_harmonics[at];
#endif
    return harmonics[at];
}

// Color of Gaussian i in a direction, clear or wet. Storage of the harmonics: 32-bit floats; halves, rows padded to an even number
// of words; or the first harmonic as halves with a half that scales the others, which are signed bytes, rows padded to whole words.
#if SH_BITS == 16
vec3 color_of(uint i, vec3 direction, bool wet) {
    uint at = i * uint((3 * coefficients + 1) / 4);
    vec3 color = vec3(0.5);
    for (int k = 0; k < coefficients; k += 4) {
        uvec2 a = stored(at, wet);
        vec2 a_y = unpackHalf2x16(a.y);
        color += sh_basis(k, direction) * vec3(unpackHalf2x16(a.x), a_y.x);
        if (k + 1 < coefficients) {
            uvec2 b = stored(at + 1u, wet), c = stored(at + 2u, wet);
            vec2 c_x = unpackHalf2x16(c.x);
            color += sh_basis(k + 1, direction) * vec3(a_y.y, unpackHalf2x16(b.x));
            color += sh_basis(k + 2, direction) * vec3(unpackHalf2x16(b.y), c_x.x);
            color += sh_basis(k + 3, direction) * vec3(c_x.y, unpackHalf2x16(c.y));
        }
        at += 3u;
    }
    return color;
}
#else
#if SH_BITS == 32
vec3 harmonic(uint i, int k, bool wet) {
    uint at = 3u * (i * uint(coefficients) + uint(k));
    return vec3(
        uintBitsToFloat(stored(at, wet)), uintBitsToFloat(stored(at + 1u, wet)), uintBitsToFloat(stored(at + 2u, wet)));
}
#else
float signed_byte(uint base, int n, bool wet) {
    return float(bitfieldExtract(int(stored(base + uint(n >> 2), wet)), 8 * (n & 3), 8));
}
vec3 harmonic(uint i, int k, bool wet) {
    uint base = i * uint(2 + (3 * coefficients) / 4);
    vec2 last = unpackHalf2x16(stored(base + 1u, wet));
    if (k == 0) return vec3(unpackHalf2x16(stored(base, wet)), last.x);
    int n = 3 * (k - 1);
    base += 2u;
    return last.y * vec3(signed_byte(base, n, wet), signed_byte(base, n + 1, wet), signed_byte(base, n + 2, wet));
}
#endif
vec3 color_of(uint i, vec3 direction, bool wet) {
    vec3 color = vec3(0.5);
    for (int k = 0; k < coefficients; ++k) color += sh_basis(k, direction) * harmonic(i, k, wet);
    return color;
}
#endif

vec3 display_color(uint i, vec3 mean, vec3 eye) {
    vec3 direction = normalize(mean - eye), color = color_of(i, direction, false);
#ifdef WET
    if (wetness > 0.0) color = (1.0 - wetness) * color + wetness * color_of(i, direction, true);
#endif
    return color_change * vec4(color, 1.0);
}

vec3 normal_color(mat3 axes, vec3 s, vec3 p) {
    vec3 normal = normalize(s.x <= s.y && s.x <= s.z ? axes[0] : (s.y <= s.z ? axes[1] : axes[2]));
    return 0.5 + 0.5 * (camera_to_world * (dot(normal, p) > 0.0 ? -normal : normal));
}

void main() {
    uint i = gl_GlobalInvocationID.x;
    bool drawn = i < count, is_selected = false, visible = false;
    Splat splat;
#ifdef MEMBERS
    if (drawn) {
        uint member = members[first_member + i];
        is_selected = member >> 31 != 0u;
        i = member & IN_CHUNK;
    }
#else
    if (drawn && has_marks) {
        uvec2 mark = (marks[i >> 5] >> (i & 31u)) & 1u;
        drawn = mark.x == 0u;
        is_selected = mark.y != 0u;
    }
#endif
    if (drawn) {
        vec4 mean_opacity = means_opacities[i];
        vec3 p = (object_to_camera * vec4(mean_opacity.xyz, 1.0)).xyz;
#ifndef LENS
        if (p.z > near)
#endif
        {
            mat3 axes = mat3(object_to_camera) * rotation_matrix(quaternions[i]);
            vec3 s = growth * vec3(scales[3u * i], scales[3u * i + 1u], scales[3u * i + 2u]);
            float opacity = min(mean_opacity.w * layer_opacity, 1.0);
            mat3 extents = mat3(axes[0] * s.x, axes[1] * s.y, axes[2] * s.z);
            visible = project(p, extents, opacity, is_rain, look == LOOK_POINTS, antialiased, splat);
            if (visible) {
                vec3 color;
                if (look == LOOK_NORMALS) color = normal_color(axes, s, p);
                else if (look == LOOK_OPACITY) color = heat_color(opacity);
                else if (look == LOOK_LAYERS) color = layer_color;
                else {
                    vec3 eye = camera_in_object;
#ifdef LENS
                    vec3 place = vec3((splat.center - intrinsics.zw) / intrinsics.xy, 1.0);
                    float part = moves ? clamp(dot(scan, place), -1.0, 1.0) : 0.0;
                    eye += part * (camera_changes[0] + part * camera_changes[1]);
#endif
                    color = display_color(i, mean_opacity.xyz, eye);
                }
                visible = !(any(isnan(color)) || any(isinf(color)));
                color = max(color, 0.0);  // after the check: some drivers' max turns NaN into 0
#ifdef MEDIUM
                if (!is_rain) {
                    float kept = medium_transmittance(p);
                    if (is_linear) color = linear_to_srgb(kept * srgb_to_linear(color) + (1.0 - kept) * airlight);
                    else color = kept * color + (1.0 - kept) * linear_to_srgb(airlight);
                }
#endif
                set_color(splat, is_selected ? tinted(color) : color);
            }
        }
    }
    emit(visible, splat, gl_WorkGroupID.x);
}
