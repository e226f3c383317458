// tinted(color): the display color of a selected splat. gsrain_engine/render/cpu/projection.py has the same numbers.

const vec3 TINT = vec3(1.0, 0.82, 0.15);
const float TINT_SHARE = 0.5;

vec3 tinted(vec3 color) {
    return mix(color, TINT, TINT_SHARE);
}
