// From a point in the camera's frame to its pixel, through a lens and at the time of its row; and the splat of a Gaussian by
// the unscented transform (3DGUT, Wu et al. 2025). gsrain_engine/render/cpu/lens_projection.py is the readable form, and
// gsrain_engine/scene/lens.py has the meaning of the numbers.

uniform float lens[19];
uniform vec3 scan;                // part of the readout of a place over the focal length (x, y, 1)
uniform vec4 edges;               // lowest and highest x/z, lowest and highest y/z at which shapes are evaluated
uniform bool by_distance;         // depth is the distance from the camera, not along the axis
uniform bool moves;
uniform mat4 first_change;        // of a point in the camera's frame in the middle of the readout, by the part s: p + s first p + s^2 second p
uniform mat4 second_change;

const float SPREAD = 1.7320508, WIDEST = 0.25, LOCAL = 0.01;

// Place in the picture over the focal length; false if the lens does not image it.
bool bent_place(vec3 p, out vec2 place) {
    bool is_imaged;
    if (lens[0] < 1.5) {
        place = p.xy / p.z;
        is_imaged = p.z > 0.0;
        if (lens[0] > 0.5) {
            float a = place.x, b = place.y, r2 = dot(place, place);
            float above = 1.0 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]));
            float radial = above / (1.0 + r2 * (lens[9] + r2 * (lens[10] + r2 * lens[11])));
            is_imaged = is_imaged && r2 <= lens[1] * lens[1];
            place = place * radial + vec2(
                2.0 * lens[6] * a * b + lens[7] * (r2 + 2.0 * a * a) + r2 * (lens[12] + r2 * lens[13]),
                lens[6] * (r2 + 2.0 * b * b) + 2.0 * lens[7] * a * b + r2 * (lens[14] + r2 * lens[15]));
        }
    } else {
        float r = length(p.xy), angle = atan(r, p.z), along = lens[18];
        for (int k = 17; k > 3; --k) along = lens[k] + angle * along;
        is_imaged = angle <= lens[1];
        place = p.xy * (r > 1e-6 * abs(p.z) ? along * angle / r : lens[4] / abs(p.z));
    }
    place += vec2(lens[2] * place.y, lens[3] * place.x);
    return is_imaged;
}

// Pixel of a point, and the point itself, at the time of its row; `aside` is a shift in the camera's frame.
bool lens_pixel(inout vec3 p, vec2 aside, out vec2 pixel) {
    vec2 place;
    p.xy += aside;
    bool is_imaged = bent_place(p, place);
    if (moves) {
        vec3 start = p, first = (first_change * vec4(p, 1.0)).xyz, second = (second_change * vec4(p, 1.0)).xyz;
        for (int k = 0; k < 5 && is_imaged; ++k) {
            float part = clamp(scan.x * place.x + scan.y * place.y + scan.z, -1.0, 1.0);
            p = start + part * (first + part * second);
            is_imaged = bent_place(p, place);
        }
    }
    pixel = intrinsics.xy * place + intrinsics.zw;
    return is_imaged;
}

// Center and covariance (xx, xy, yy) of a splat in pixels, before its footprint, and the point and its depth; false if it is
// not drawn.
bool lens_shape(inout vec3 p, mat3 axes, out vec2 center, out vec3 covariance, out float depth) {
    vec3 start = p;
    vec2 at;
    if (!lens_pixel(p, vec2(0.0), center)) return false;
    float far = length(p);
    depth = by_distance ? far : p.z;
    if (!(depth > near && depth < 1e30)) return false;
    vec2 aside = vec2(0.0);
    at = center;
    if (lens[0] < 1.5) {
        vec2 slope = p.xy / p.z, bounded = clamp(slope, edges.xz, edges.yw);
        if (bounded != slope) {
            vec3 moved = start;
            aside = bounded * p.z - p.xy;
            if (!lens_pixel(moved, aside, at)) return false;
        }
    }
    float longest = SPREAD * sqrt(max(max(dot(axes[0], axes[0]), dot(axes[1], axes[1])), dot(axes[2], axes[2])));
    float share = min(1.0, WIDEST * far / max(longest, 1e-30));
    for (int attempt = 0; attempt < 2; ++attempt) {
        vec2 mean = vec2(0.0);
        covariance = vec3(0.0);
        bool all_imaged = true;
        for (int k = 0; k < 6; ++k) {
            vec3 q = start + ((k & 1) == 0 ? share : -share) * SPREAD * axes[k >> 1];
            vec2 d;
            all_imaged = lens_pixel(q, aside, d) && all_imaged;
            d -= at;
            mean += d;
            covariance += vec3(d.x * d.x, d.x * d.y, d.y * d.y);
        }
        if (all_imaged && !any(isnan(covariance)) && !any(isinf(covariance))) {
            mean /= 6.0;
            covariance = (covariance / 6.0 + vec3(mean.x * mean.x, mean.x * mean.y, mean.y * mean.y)) / (share * share);
            center += mean;
            return true;
        }
        share *= LOCAL / WIDEST;
    }
    return false;
}
