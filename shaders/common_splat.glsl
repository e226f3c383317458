// A projected Gaussian ("splat"): the 32 bytes that the projection pass writes and the drawing pass reads.

struct Splat {
    vec2 center;       // px
    vec2 first_axis;   // one standard deviation (px); the second axis is perpendicular
    float second;      // length of the second axis (px), negative for rain
    float depth;       // along the view axis (m)
    uvec2 appearance;  // color and largest alpha, packed
};

// Color and largest alpha in 64 bits: three significands of 14 bits with one exponent of 6 bits, and a half. Three halves
// need as much room, with steps of 1/2048 just below white: too coarse for the contrast of a far wall in rain.
const uint EXPONENT_OFFSET = 80u;  // from the exponent of a 32-bit float; 2^-47 to 2^16 remain

uvec2 packed_color(vec3 color) {
    float largest = clamp(max(color.r, max(color.g, color.b)), 1e-14, 65504.0);
    uint exponent = floatBitsToUint(largest) >> 23, stored = exponent - EXPONENT_OFFSET;
    float steps = uintBitsToFloat((267u - exponent) << 23);  // 2^14 for colors from 0.5 to 1
    uvec3 c = uvec3(roundEven(min(steps * color, vec3(16383.0))));
    return uvec2(c.r | (c.g << 14) | (stored << 28), c.b | ((stored >> 4) << 14));
}

vec3 color_in(uvec2 appearance) {
    uint stored = (appearance.x >> 28) | ((appearance.y >> 10) & 0x30u);
    uvec3 c = uvec3(appearance.x & 0x3FFFu, (appearance.x >> 14) & 0x3FFFu, appearance.y & 0x3FFFu);
    return uintBitsToFloat((stored + EXPONENT_OFFSET - 13u) << 23) * vec3(c);
}

float alpha_in(uvec2 appearance) {
    return unpackHalf2x16(appearance.y).y;
}
