// From a Gaussian in the camera's frame to a splat: cull, 2D covariance, exact extent.
// Zwicker et al. 2002 (EWA splatting) as used by Kerbl et al. 2023; limits for off-center cameras as in gsplat.

#include "common_alpha.glsl"
#include "common_splat.glsl"

uniform vec4 intrinsics;          // fx fy cx cy (px)
uniform vec2 image_size;          // px
uniform vec2 rows_outside;        // of the whole picture, above and below a band of it
uniform float near;               // m

#ifdef LENS
bool lens_shape(inout vec3 p, mat3 axes, out vec2 center, out vec3 covariance, out float depth);  // of common_lens.glsl
#endif

const float DILATION = 0.3;       // px^2, added to the 2D covariance: the pixel's own footprint
const float ANTIALIASED = 0.1;    // px^2, the same for antialiased Gaussians

// Splat of a Gaussian at p (m) with axes * axes^T as its covariance (m^2), both in the camera's frame, but for its
// color. False if none of it is drawn. With LENS, p becomes the place at the time of its row.
bool project(
#ifdef LENS
    inout vec3 p,
#else
    vec3 p,
#endif
    mat3 axes, float opacity, bool is_rain, bool as_point, bool antialiased, out Splat splat
) {
#ifdef LENS
    vec2 center;
    vec3 covariance;
    float depth;
    if (!lens_shape(p, axes, center, covariance, depth)) return false;
    float a = covariance.x, b = covariance.y, d = covariance.z;
#else
    if (!(p.z > near && p.z < 1e30)) return false;  // also drops NaN

    // Local affine approximation of the projection, held back at 1.3 times the field of view.
    vec2 f = intrinsics.xy, c = intrinsics.zw, above = vec2(0.0, rows_outside.x), below = vec2(0.0, rows_outside.y);
    vec2 margin = 0.15 * (image_size + above + below) / f;
    vec2 slope = clamp(p.xy / p.z, -(c + above) / f - margin, (image_size + below - c) / f + margin);
    vec3 ux = vec3(f.x / p.z, 0.0, -f.x * slope.x / p.z) * axes;
    vec3 uy = vec3(0.0, f.y / p.z, -f.y * slope.y / p.z) * axes;
    float a = dot(ux, ux), b = dot(ux, uy), d = dot(uy, uy);
    float depth = p.z;
    vec2 center = f * p.xy / p.z + c;
#endif
    float before = max(a * d - b * b, 0.0);
    float footprint = antialiased ? ANTIALIASED : DILATION;
    a += footprint;
    d += footprint;
    if (as_point) { a = 1.0; d = 1.0; b = 0.0; opacity = 1.0; }
    float determinant = a * d - b * b;
    float cut = is_rain ? RAIN_ALPHA_CUT : SCENE_ALPHA_CUT;
    if (is_rain || (antialiased && !as_point)) opacity *= sqrt(before / determinant);  // keeps the integral of alpha (Yu et al. 2024)
    if (!(opacity > cut) || !(determinant > 0.0) || isinf(determinant)) return false;

    vec2 reach = sqrt(2.0 * log(opacity / cut) * vec2(a, d));  // exact: alpha is the cut at the edge
    if (any(lessThan(center + reach, vec2(0))) || any(greaterThan(center - reach, image_size))) return false;

    float large = 0.5 * (a + d) + length(vec2(0.5 * (a - d), b));
    vec2 axis = abs(b) > 1e-9 * large ? normalize(vec2(b, large - a)) : (a >= d ? vec2(1, 0) : vec2(0, 1));
    splat.center = center;
    splat.first_axis = sqrt(large) * axis;
    splat.second = sqrt(max(determinant / large, 1e-6)) * (is_rain ? -1.0 : 1.0);
    splat.depth = depth;
    splat.appearance = uvec2(0u, packHalf2x16(vec2(0.0, opacity)));
    return true;
}

void set_color(inout Splat splat, vec3 color) {
    uvec2 color_bits = packed_color(color);
    splat.appearance = uvec2(color_bits.x, (splat.appearance.y & 0xFFFF0000u) | color_bits.y);
}
