#version 430
// Converts the premultiplied picture over a background to red, green and blue bytes without gaps, so that a third of what
// four floats would take is read back. One thread writes three words: four pixels, counted row by row.
// No races: nothing is shared, and each thread writes its own words.

layout(local_size_x = 256) in;

layout(std430, binding = 0) writeonly buffer Bytes { uint words[]; };

uniform sampler2D picture;
uniform uvec2 size;        // px
uniform vec3 background;   // display color

void main() {
    uint four = gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * gl_NumWorkGroups.x * 256u, pixels = size.x * size.y;
    if (4u * four >= pixels) return;
    uint bytes[12];
    for (uint k = 0u; k < 4u; ++k) {
        uint pixel = min(4u * four + k, pixels - 1u);
        vec4 texel = texelFetch(picture, ivec2(pixel % size.x, pixel / size.x), 0);
        vec3 levels = roundEven(255.0 * clamp(texel.rgb + (1.0 - texel.a) * background, 0.0, 1.0));
        bytes[3u * k] = uint(levels.r);
        bytes[3u * k + 1u] = uint(levels.g);
        bytes[3u * k + 2u] = uint(levels.b);
    }
    for (uint k = 0u; k < 3u; ++k) {
        words[3u * four + k] = bytes[4u * k] | bytes[4u * k + 1u] << 8u | bytes[4u * k + 2u] << 16u | bytes[4u * k + 3u] << 24u;
    }
}
