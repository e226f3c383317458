#version 430
// Makes the streak Gaussians of the found drops and projects them, one thread per drop; gsrain_engine/rain/
// streaks.py is the readable form (paper, eq. 4-7 and 10-12).
// No races: only `emit` shares data; `max_copies` is the same for all threads, so each calls it equally often, and each copy
// has its own block.

layout(local_size_x = 256) in;

#include "common_projection.glsl"
#include "common_drop_field.glsl"
#ifdef LAMPS
#include "common_srgb.glsl"
#include "common_medium.glsl"
#include "common_lamps.glsl"
#endif

layout(std430, binding = 2) readonly buffer Found { uint found_masks[]; };
layout(std430, binding = 3) readonly buffer Places { uint found_places[]; };  // scanned counts
layout(std430, binding = 6) readonly buffer FoundWork { uint unused[5]; uint found_count; };

uniform uint first_of_class;  // class c belongs to the drops c * this mod CLASSES, that plus CLASSES, and so on
uniform uint masks_by_class;
uniform float exposure;       // s
uniform vec3 shutter_velocity;  // of the camera along the axes of the cell (m/s); 0 for the paper's form
uniform bool still_camera;    // opacity by the speed itself, not by that across the line of sight
uniform float focal;          // px, of the output image
uniform float phi, haze_opacity, gain;
uniform float aperture;       // diameter of the lens opening (m)
uniform float focus;          // distance that is sharp (m)
uniform vec4 scan;            // rolling shutter: duration (s), and its course over x/z, y/z, and from the axis
uniform uint max_copies;
uniform vec3 display_color;

const float PI = 3.14159265358979;
const float MAX_STRETCH = 2.0;

// The n-th drop that was found: its class, and its number.
uint find_class(uint n, out uint i) {
    uint low = 0u, high = masks_by_class * CLASSES;
    while (high - low > 1u) {
        uint middle = (low + high) / 2u;
        if (found_places[middle] <= n) low = middle; else high = middle;
    }
    uint mask = found_masks[low], c = low / masks_by_class;
    for (uint skip = n - found_places[low]; skip > 0u; --skip) mask &= mask - 1u;
    i = ((low % masks_by_class) * 32u + uint(findLSB(mask))) * CLASSES + c * first_of_class % CLASSES;
    return c;
}

void main() {
    uint n = gl_GlobalInvocationID.x;
    if (gl_WorkGroupID.x * 256u >= found_count) return;  // there was room for more
    bool there = n < found_count;
    vec3 p = vec3(0.0), direction = vec3(0.0, 0.0, 1.0);
    float opacity = 0.0, across_sigma = 0.0, along_sigma = 0.0, spacing = 0.0;
    uint copies = 0u;
    if (there) {
        uint i, c = find_class(n, i);
        PlacedDrop drop = place(i, c);
        p = cell_to_camera * (in_cell(drop.at) - camera_in_cell);
        float diameter = drop_classes[c].diameter;
        vec3 velocity = cell_to_camera * (velocity_of(drop, c) - shutter_velocity);
        float stretch = 1.0;
        if (scan.x > 0.0 && p.z > 0.0) {
            vec2 at = p.xy / p.z;
            float rate = dot(scan.yz, velocity.xy - at * velocity.z) / p.z;
            stretch = 1.0 / max(1.0 - scan.x * rate, 1.0 / MAX_STRETCH);
            p += clamp(scan.x * stretch * (dot(scan.yz, at) + scan.w), -scan.x, scan.x) * velocity;
        }
        vec3 sight = p / max(length(p), 1e-9);
        float across = length(velocity - dot(velocity, sight) * sight), speed = length(velocity), limit = focal * diameter;
        float smeared = (still_camera ? speed : across) * exposure;
        float alpha = min(1.0, diameter / max(smeared, 1e-12)) * min(1.0, limit / max(p.z, 1e-9));
        if (p.z > phi * limit) alpha = haze_opacity;
        alpha = min(1.0, gain * alpha);
        // Copies overlap: their opacities would add up to sqrt(2 pi) alpha.
        opacity = 1.0 - pow(1.0 - alpha, inversesqrt(2.0 * PI));
        float narrowing = alpha / max(sqrt(2.0 * PI) * opacity, 1e-30);
        float ratio = diameter > 1e-3 ? -70.0 * diameter + 1.07 : 1.0, streak = speed * exposure * stretch;
        copies = uint(clamp(roundEven(streak / (ratio * diameter)), 1.0, float(max_copies)));
        spacing = streak / float(copies);
        across_sigma = sqrt(PI / 32.0) * max(diameter, p.z / focal) * narrowing;
        along_sigma = max(spacing, across_sigma);
        direction = velocity / max(speed, 1e-9);
        if (aperture > 0.0) {
            float blur = 0.25 * aperture * abs(1.0 - p.z / focus);  // standard deviation of the circle of confusion
            float sine = across / max(speed, 1e-9);
            float seen_sigma = length(vec2(along_sigma * sine, across_sigma * sqrt(max(1.0 - sine * sine, 0.0))));
            float blurred_across = length(vec2(across_sigma, blur));
            opacity *= across_sigma / blurred_across * seen_sigma / length(vec2(seen_sigma, blur));
            across_sigma = blurred_across;
            along_sigma = length(vec2(along_sigma, blur));
        }
    }
    vec3 side = normalize(abs(direction.x) < 0.7 ? cross(direction, vec3(1, 0, 0)) : cross(direction, vec3(0, 1, 0)));
    mat3 axes = mat3(across_sigma * side, across_sigma * cross(direction, side), along_sigma * direction);
    for (uint copy = 0u; copy < max_copies; ++copy) {
        Splat splat;
        bool visible = false;
        if (copy < copies) {
            vec3 center = p + (float(copy) - 0.5 * float(copies - 1u)) * spacing * direction;
            visible = project(center, axes, opacity, true, false, false, splat);
#ifdef LAMPS
            if (visible) set_color(splat, light_of_drop(center));
#else
            if (visible) set_color(splat, display_color);
#endif
        }
        emit(visible, splat, gl_WorkGroupID.x * max_copies + copy);
    }
}
