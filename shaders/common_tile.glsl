// Tiles of 16 x 16 pixels, and which of them a splat's ellipse meets: those whose rectangle of pixel centers does, row by
// row (the idea of Speedy-Splat, Hanson et al. 2025), as in gsrain_engine/render/cpu/tiles.py column by column.

#define SPLAT_ACCESS readonly
#define LOADS_SPLATS
#include "common_alpha.glsl"
#include "common_splat.glsl"
#include "common_splat_blocks.glsl"

const uint TILE = 16u;  // px
const float SLACK = 1e-2;  // px; margin for rounding

uniform uvec2 tiles;      // columns and rows of tiles that are drawn
uniform uint first_row;   // of tiles

float alpha_cut(bool is_rain) {
#ifdef ELLIPSOIDS
    return SURFACE_ALPHA;
#else
    return is_rain ? RAIN_ALPHA_CUT : SCENE_ALPHA_CUT;
#endif
}

// Ellipse on which alpha is the cut: |x - shear y| <= sqrt(spread (depth - y^2 / yy)), measured from its center.
struct Ellipse {
    vec2 center;  // px
    float depth;  // twice the logarithm of alpha over the cut at the center; not above 0: nothing is drawn
    float shear;
    float spread, yy;  // px^2
    float turn;   // y of the rightmost point; the leftmost is opposite
};

Ellipse ellipse_of(Splat splat) {
    vec2 a = splat.first_axis;
    float major = dot(a, a), minor = splat.second * splat.second;
    vec2 b = splat.second * inversesqrt(major) * vec2(-a.y, a.x);
    float xx = a.x * a.x + b.x * b.x, xy = a.x * a.y + b.x * b.y, yy = a.y * a.y + b.y * b.y;
    float alpha = alpha_in(splat.appearance);
    float depth = 2.0 * log(max(alpha, 1e-30) / alpha_cut(splat.second < 0.0));
    return Ellipse(splat.center, depth, xy / yy, major * minor / yy, yy, xy * sqrt(max(depth, 0.0) / xx));
}

// First and past-the-last of `count` tiles with a pixel center in [low, high] px.
uvec2 tiles_between(float low, float high, uint first, uint count) {
    float limit = float(count), start = float(first);
    float from = ceil((low - (float(TILE) - 0.5) - SLACK) / float(TILE)) - start;
    float to = floor((high - 0.5 + SLACK) / float(TILE)) + 1.0 - start;
    return uvec2(clamp(from, 0.0, limit), clamp(max(from, to), 0.0, limit));
}

uvec2 rows_of(Ellipse e) {  // counted from `first_row`
    float reach = sqrt(max(e.depth, 0.0) * e.yy);
    return e.depth > 0.0 ? tiles_between(e.center.y - reach, e.center.y + reach, first_row, tiles.y) : uvec2(0u);
}

uvec2 columns_of(Ellipse e, uint row) {
    float reach = sqrt(e.depth * e.yy), top = float((first_row + row) * TILE) + 0.5 - SLACK - e.center.y;
    float low = clamp(top, -reach, reach), high = clamp(top + float(TILE) - 1.0 + 2.0 * SLACK, -reach, reach);
    float at_right = clamp(e.turn, low, high), at_left = clamp(-e.turn, low, high);
    float right = e.shear * at_right + sqrt(e.spread * max(e.depth - at_right * at_right / e.yy, 0.0));
    float left = e.shear * at_left - sqrt(e.spread * max(e.depth - at_left * at_left / e.yy, 0.0));
    return tiles_between(e.center.x + left, e.center.x + right, 0u, tiles.x);
}
