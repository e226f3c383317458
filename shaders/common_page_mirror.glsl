// Rays of a page's mirror image, whose first row is the uppermost; gsrain_engine/water/mirror.py is the readable form.

uniform vec4 intrinsics;    // fx fy cx cy (px)
uniform ivec2 mirror_size;  // px
uniform vec3 upward;        // in the camera's frame

const float MIN_SINE = 2e-3;  // of a ray's angle to the ground; others pass over it

vec3 ray_of(ivec2 pixel) {
    return vec3((vec2(pixel) + 0.5 - intrinsics.zw) / intrinsics.xy, 1.0);
}

// Sine of the angle between a ray and the ground, below 0 for rays that go up.
float sine_to_ground(vec3 ray) {
    return -dot(upward, ray) / length(ray);
}
