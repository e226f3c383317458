// Rain as a medium: the share of light that arrives from a point in the camera's frame; gsrain_engine/rain/medium.py is the
// readable form, with the meaning of the numbers.

uniform float medium_numbers[33];
uniform float medium_drawn[64];   // optical depth that streaks take, by depth along the view axis
uniform vec3 airlight;            // in linear light
uniform vec4 medium_floor;        // upward direction in the camera's frame, height of the camera over the floor (m)
#ifdef LENS
uniform bool medium_by_distance;  // streaks reach up to a distance, not to a depth along the view axis
#endif

// Distances at which the ray to a point enters and leaves a box, between 0 and its length.
vec2 medium_within(vec3 p, float length_m, int at) {
    vec2 part = vec2(0.0, length_m);
    for (int row = 0; row < 3; ++row) {
        int k = at + 3 * row;
        float along = dot(vec3(medium_numbers[k], medium_numbers[k + 1], medium_numbers[k + 2]), p) / length_m;
        float start = medium_numbers[at + 9 + row], extent = medium_numbers[at + 12 + row];
        along = abs(along) > 1e-9 ? along : 1e-9;
        float first = (-extent - start) / along, second = (extent - start) / along;
        part = vec2(max(part.x, min(first, second)), min(part.y, max(first, second)));
    }
    return vec2(part.x, max(part.x, part.y));
}

float medium_drawn_up_to(float depth) {
    float at = clamp(depth / medium_numbers[1], 0.0, 63.0);
    int k = min(int(at), 62);
    return mix(medium_drawn[k], medium_drawn[k + 1], at - float(k));
}

// Optical depth up to a point.
float medium_depth(vec3 p) {
    float length_m = length(p);
    vec2 all = medium_numbers[32] > 0.0 ? medium_within(p, length_m, 17) : vec2(0.0, length_m);
    float depth = medium_numbers[0] * (all.y - all.x);
    vec2 part = medium_within(p, length_m, 2);
    part = vec2(max(part.x, all.x), min(part.y, all.y));
#ifdef LENS
    float slope = medium_by_distance ? 1.0 : p.z / length_m;
#else
    float slope = p.z / length_m;
#endif
    if (part.y > part.x && slope > 0.0) {
        depth -= (medium_drawn_up_to(part.y * slope) - medium_drawn_up_to(part.x * slope)) / slope;
    }
    return max(depth, 0.0);
}

float medium_transmittance(vec3 p) {
    return exp(-medium_depth(p));
}

// Airlight behind the scene along a unit direction, premultiplied.
vec4 medium_sky_along(vec3 ray) {
    float length_m = min(medium_floor.w / max(-dot(medium_floor.xyz, ray), 1e-9), 1e9);
    return (1.0 - medium_transmittance(length_m * ray)) * vec4(linear_to_srgb(airlight), 1.0);
}

// Airlight behind the scene at a point of the image (px), premultiplied; `intrinsics` are fx fy cx cy (px).
vec4 medium_sky(vec2 point, vec4 intrinsics) {
    vec3 ray = vec3((point - intrinsics.zw) / intrinsics.xy, 1.0);
    return medium_sky_along(ray / length(ray));
}
