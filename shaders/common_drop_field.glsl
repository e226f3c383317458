// Drop field: position of drop i as a function of (seed, t). The same integers as in gsrain_engine/rain/drop_field.py,
// bit for bit: `precise` forbids fused and reordered operations. pcg4d: Jarzynski and Olano 2020, "Hash Functions for
// GPU Rendering".

const uint CLASSES = 16384u, NODES = 257u;

struct DropClass {
    float far, margin;   // view depth beyond which haze represents them; reach of a streak (m)
    float diameter;      // m
    float fall_speed;    // m/s
    float air[3];        // as in `DropAir.by_class`
};

layout(std430, binding = 0) readonly buffer Moved {
    float air_numbers[8];         // as in `DropAir.numbers`
    float air_rows[10u * NODES];  // as in `DropAir.rows`
    uint across[4];               // whole periods between the cell and the drops, x y, and the rest, in 2^-32 of a period
    uvec2 fallen[];               // the same along z, for each class
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

struct PlacedDrop {
    uvec3 at;        // fractions of the cell: 0 is the lower face, 2^32 the upper one
    ivec2 own_steps; // velocity of its own along x and y
};

int own_steps(uint drawn) {  // sum of four bytes, less its mean
    uint pairs = (drawn & 0x00FF00FFu) + ((drawn >> 8u) & 0x00FF00FFu);
    return int((pairs & 0xFFFFu) + (pairs >> 16u)) - 510;
}

float air_at(uint row, uint z) {
    precise float share = float(z & 0xFFFFFFu) * (1.0 / 16777216.0);
    uint node = row * NODES + (z >> 24u);
    precise float value = air_rows[node] + share * (air_rows[node + 1u] - air_rows[node]);
    return value;
}

float own_offset(uint z, int steps, float own) {
    precise float height = air_numbers[0] + float(z >> 8u) * (1.0 / 16777216.0) * air_numbers[1];
    precise float offset = float(steps) * own * height;
    return offset;
}

// Sine and cosine of the gusts' wavenumber times x from the middle of the cell.
vec2 gust_turn(uint x) {
    precise float turn = (float(x >> 8u) * (1.0 / 16777216.0) - 0.5) * air_numbers[3] * air_numbers[2];
    precise float square = turn * turn;
    precise float sine = turn * (1.0 + square * (-1.0 / 6.0 + square * (1.0 / 120.0 + square * (-1.0 / 5040.0))));
    precise float cosine =
        1.0 + square * (-0.5 + square * (1.0 / 24.0 + square * (-1.0 / 720.0 + square * (1.0 / 40320.0))));
    return vec2(sine, cosine);
}

uint part_of_period(float periods) {
    precise float rest = min(periods - floor(periods), 1.0 - 1.0 / 16777216.0);
    return uint(int(rest * 16777216.0)) << 8u;
}

PlacedDrop place(uint i, uint c) {
    uint start = pcg4d(uvec4(i, 0u, 0u, seed)).z;
    uint z = start + fallen[c].y;
    uint wrap_z = fallen[c].x + uint(z < start);
    uvec4 drawn = pcg4d(uvec4(i, wrap_z, 1u, seed));
    ivec2 steps = ivec2(own_steps(drawn.y), own_steps(drawn.z));
    float slow = drop_classes[c].air[0], gust = drop_classes[c].air[1], own = drop_classes[c].air[2];
    precise float offset =
        (air_at(0u, z) * slow + air_at(2u, z) * gust + own_offset(z, steps.x, own)) * air_numbers[4];
    uint part = part_of_period(offset);
    uint lattice_x = drawn.x + across[2];
    uint x = lattice_x + part;
    uint wrap_x = across[0] + uint(lattice_x < drawn.x) + uint(x < part) + uint(int(floor(offset)));
    vec2 turn = gust_turn(x);
    precise float gusts = (air_at(3u, z) * turn.x + air_at(4u, z) * turn.y) * gust;
    precise float offset_y = (air_at(1u, z) * slow + gusts + own_offset(z, steps.y, own)) * air_numbers[4];
    start = pcg4d(uvec4(i, wrap_z, wrap_x * 2u + 2u, seed)).y;
    return PlacedDrop(uvec3(x, start + across[3] + part_of_period(offset_y), z), steps);
}

vec3 in_cell(uvec3 fractions) {  // m, from the centre
    return (vec3(fractions) * (1.0 / 4294967296.0) - 0.5) * period;
}

// Velocity of a drop along the axes of the cell (m/s).
vec3 velocity_of(PlacedDrop drop, uint c) {
    uint x = drop.at.x, z = drop.at.z;
    vec2 turn = gust_turn(x);
    vec2 own = drop_classes[c].air[0] > 0.0 ? -drop_classes[c].air[2] / drop_classes[c].air[0] * vec2(drop.own_steps)
                                            : vec2(0.0);
    float along_x = air_at(5u, z) + air_at(7u, z) + own.x;
    float carried = (along_x - air_numbers[5]) * air_numbers[2] * drop_classes[c].air[1] *
                    (air_at(3u, z) * turn.y - air_at(4u, z) * turn.x);
    float along_y = air_at(6u, z) + air_at(8u, z) * turn.y + air_at(9u, z) * turn.x + carried + own.y;
    return vec3(along_x, along_y, -drop_classes[c].fall_speed);
}
