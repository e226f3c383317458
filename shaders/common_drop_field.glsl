// Drop field: position of drop i as a function of (seed, t). The same integers as in gsrain_engine/rain/drop_field.py,
// bit for bit. pcg4d: Jarzynski and Olano 2020, "Hash Functions for GPU Rendering".

const uint CLASSES = 16384u;

struct DropClass {
    uint wraps[3];       // whole periods between the cell and the drops of the class, x y z
    uint fractions[3];   // and the rest, in 2^-32 of a period
    float far, margin;   // view depth beyond which haze represents them; reach of a streak (m)
    float diameter;      // m
    float velocity[3];   // in the camera's frame, relative to the shutter (m/s)
};

layout(std430, binding = 1) readonly buffer Classes { DropClass drop_classes[]; };

uniform uint seed;
uniform vec3 period;          // of the cell (m)
uniform vec3 camera_in_cell;  // from the centre of the cell (m)
uniform mat3 cell_to_camera;

uvec4 pcg4d(uvec4 v) {
    v = v * 1664525u + 1013904223u;
    v.x += v.y * v.w; v.y += v.z * v.x; v.z += v.x * v.y; v.w += v.y * v.z;
    v ^= v >> 16u;
    v.x += v.y * v.w; v.y += v.z * v.x; v.z += v.x * v.y; v.w += v.y * v.z;
    return v;
}

// Position of drop i of class c in fractions of the cell: 0 is the lower face, 2^32 the upper one.
uvec3 place(uint i, uint c) {
    uint start = pcg4d(uvec4(i, 0u, 0u, seed)).z;
    uint z = start + drop_classes[c].fractions[2];
    uint wrap_z = drop_classes[c].wraps[2] + uint(z < start);
    start = pcg4d(uvec4(i, wrap_z, 1u, seed)).x;
    uint x = start + drop_classes[c].fractions[0];
    uint wrap_x = drop_classes[c].wraps[0] + uint(x < start);
    start = pcg4d(uvec4(i, wrap_z, wrap_x * 2u + 2u, seed)).y;
    return uvec3(x, start + drop_classes[c].fractions[1], z);
}

vec3 in_cell(uvec3 fractions) {  // m, from the centre
    return (vec3(fractions) * (1.0 / 4294967296.0) - 0.5) * period;
}
