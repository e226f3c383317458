// A pass of the radix sort looks at DIGIT_BITS bits of each key; a workgroup of 256 threads takes 2048 keys, in 8 rounds.
// Count, then scan, then scatter: no workgroup waits for another, so it runs on every OpenGL 4.3.

const uint DIGIT_BITS = 7u, DIGITS = 1u << DIGIT_BITS, ROUNDS = 8u, KEYS_BY_GROUP = 256u * ROUNDS;

layout(local_size_x = 256) in;

layout(std430, binding = 0) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 7) readonly buffer Work { uint draw_command[5]; uint key_count; };

uniform uint shift;  // of the digit's lowest bit

// The dispatch has a workgroup for each KEYS_BY_GROUP keys that may be there; those beyond `groups()` have nothing to do.
uint group() {
    return gl_WorkGroupID.x + gl_WorkGroupID.y * gl_NumWorkGroups.x;
}

uint groups() {
    return (key_count + KEYS_BY_GROUP - 1u) / KEYS_BY_GROUP;
}

uint digit_of(uint key) {
    return (key >> shift) & (DIGITS - 1u);
}
