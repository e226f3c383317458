// Lamps before the camera and the light of a drop; gsrain_engine/rain/lamp_light.py is the readable form, with the meaning of
// the numbers. Needs common_medium.glsl.

uniform sampler2D lamp_numbers;  // one row of 18 for each lamp
uniform sampler2D lamp_phase;    // at ANGLES steps from 0 to pi: sums over the angle in the medium; phase function of a drop
uniform int lamp_count;

const int ANGLES = 721;
const float PER_ANGLE = float(ANGLES - 1) / 3.14159265358979;

float lamp(int i, int k) { return texelFetch(lamp_numbers, ivec2(k, i), 0).r; }

vec3 lamp_vector(int i, int k) { return vec3(lamp(i, k), lamp(i, k + 1), lamp(i, k + 2)); }

// Share of the light at the cosine of an angle from the axis.
float lamp_cone(float cosine, float ends, float full) {
    return smoothstep(0.0, 1.0, (cosine - ends) / max(full - ends, 1e-6));
}

// Sum (row 0) or phase function of a drop (row 1) at an angle.
float lamp_scattering(float angle, int row) {
    float at = clamp(angle * PER_ANGLE, 0.0, float(ANGLES - 1));
    int k = min(int(at), ANGLES - 2);
    return mix(texelFetch(lamp_phase, ivec2(k, row), 0).r, texelFetch(lamp_phase, ivec2(k + 1, row), 0).r, at - float(k));
}

// Optical depth of the medium from lamp i along a vector v of a length, all drops counted.
float lamp_depth(vec3 v, float length_m, int i) {
    if (medium_numbers[32] == 0.0) return medium_numbers[0] * length_m;
    vec2 part = vec2(0.0, length_m);
    for (int row = 0; row < 3; ++row) {
        int k = 17 + 3 * row;
        float along = dot(vec3(medium_numbers[k], medium_numbers[k + 1], medium_numbers[k + 2]), v);
        float start = lamp(i, 13 + row), extent = medium_numbers[29 + row];
        float inverse = length_m / (abs(along) > 1e-9 ? along : 1e-9);
        float first = (-extent - start) * inverse, second = (extent - start) * inverse;
        part = vec2(max(part.x, min(first, second)), min(part.y, max(first, second)));
    }
    return medium_numbers[0] * max(part.y - part.x, 0.0);
}

// Linear light of a drop at p by all lamps, over its own cross-section.
vec3 light_of_drop(vec3 p) {
    vec3 light = vec3(0.0), sight = p / max(length(p), 1e-6);
    float before = medium_depth(p);
    for (int i = 0; i < lamp_count; ++i) {
        vec3 v = p - lamp_vector(i, 0);
        float length_m = max(length(v), 0.1);
        float share = lamp_cone(dot(lamp_vector(i, 3), v) / length_m, lamp(i, 9), lamp(i, 10));
        if (share <= 0.0) continue;
        float angle = acos(clamp(-dot(v, sight) / length_m, -1.0, 1.0));
        share *= lamp_scattering(angle, 1) * exp(-before - lamp_depth(v, length_m, i));
        light += share / (6.28318530717959 * length_m * length_m) * lamp_vector(i, 6);
    }
    return light;
}
