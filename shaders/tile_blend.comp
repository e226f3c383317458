#version 430
// Blends the splats of a tile, nearest first, one thread per pixel, and adds the rain's light to the scene's. A pixel is
// finished where hardly any light is left, as in gsrain_engine/render/cpu/tiles.py.
// No races: a batch of splats is written and read between barriers, and so is the number of unfinished pixels, which is
// changed by atomics only; each thread writes its own pixel.

layout(local_size_x = 16, local_size_y = 16) in;

#include "common_tile.glsl"
#include "common_srgb.glsl"
#include "common_rain_light.glsl"

layout(std430, binding = 2) readonly buffer Slots { uint slots[]; };    // of the splats of each tile, nearest first
layout(std430, binding = 4) readonly buffer Starts { uint starts[]; };  // of each tile's slots

layout(rgba32f, binding = 0) writeonly uniform image2D picture;
#ifdef WITH_DEPTH
#ifdef LAMPS
layout(rgba32f, binding = 1) writeonly uniform image2D depths;  // also weighted share_of_depth, as in lamp_light.py
#else
layout(rg32f, binding = 1) writeonly uniform image2D depths;  // weighted depth and weight, of the scene alone
#endif
#endif

#ifdef LAMPS
layout(rgba32f, binding = 2) writeonly uniform image2D lamp_lights;  // of the rain, in linear light: the color of its splats
#endif

uniform uvec2 image_size;  // px
#ifdef LINEAR_RAIN
uniform vec3 rain_light;   // a drop's color in linear light
#endif
#ifdef MEDIUM
#include "common_medium.glsl"
uniform vec4 intrinsics;   // fx fy cx cy (px)
#endif
#ifdef LENS
uniform sampler2D rays;    // unit directions of the pixels in the camera's frame; alpha 0 where none comes
#endif

const float MIN_TRANSMITTANCE = 1e-4;
const float TO_OFFSET = sqrt(0.5 / log(2.0));  // offsets are scaled so that alpha falls by 2^-(offset^2)
const uint BATCH = 256u;

shared vec4 center_along[BATCH];  // center; along the first axis, per offset
shared vec4 across_alpha[BATCH];  // along the second axis, log2 of alpha, depth (negative for rain)
shared vec3 colors[BATCH];
shared uint unfinished;

void main() {
    uint tile = gl_WorkGroupID.y * tiles.x + gl_WorkGroupID.x, thread = gl_LocalInvocationIndex;
    uvec2 pixel = uvec2(gl_GlobalInvocationID.x, gl_GlobalInvocationID.y + first_row * TILE);
    vec2 middle = vec2(pixel) + 0.5;
    bool inside = pixel.x < image_size.x && pixel.y < image_size.y, done = !inside;
    vec4 scene = vec4(0.0);        // premultiplied; in LINEAR_RAIN of the scene alone
    float open = 1.0;              // what it lets through
    float fragments = 0.0;
    float open_rain = 1.0;         // and what the rain alone lets through
    vec2 shares = vec2(0.0);       // visible share of rain and scene through each other
    vec2 weighted_depth = vec2(0.0);
    float open_scene = 1.0;
    vec3 lamp_light = vec3(0.0);
    float depth_share = 0.0;
    uint first = starts[tile], last = starts[tile + 1u];
    for (uint start = first; start < last; start += BATCH) {
        if (thread == 0u) unfinished = 0u;
        barrier();
        if (!done) atomicAdd(unfinished, 1u);
        barrier();
        if (unfinished == 0u) break;
        if (start + thread < last) {
            Splat splat = load_splat(slots[start + thread]);
            vec2 a = splat.first_axis;
            float major = dot(a, a);
            vec2 b = vec2(-a.y, a.x) * inversesqrt(major);
            center_along[thread] = vec4(splat.center, TO_OFFSET / major * a);
            across_alpha[thread] = vec4(
                TO_OFFSET / abs(splat.second) * b, log2(alpha_in(splat.appearance)), splat.second < 0.0 ? -splat.depth : splat.depth);
            colors[thread] = color_in(splat.appearance);
        }
        barrier();
        uint count = min(BATCH, last - start);
        for (uint k = 0u; k < count && !done; ++k) {
            vec4 c = center_along[k], x = across_alpha[k];
            vec2 from = middle - c.xy;
            vec2 offset = vec2(dot(from, c.zw), dot(from, x.xy));
            float exponent = dot(offset, offset);
#ifdef ELLIPSOIDS
            float height = 1.0 - exponent / (x.z - log2(SURFACE_ALPHA));
            if (height >= 0.0) {
                scene = vec4(colors[k] * (0.5 + 0.5 * sqrt(height)), 1.0);
                weighted_depth = vec2(x.w, 1.0);
                done = true;
            }
            continue;
#endif
            bool is_rain = x.w < 0.0;
            float alpha = min(MAX_ALPHA, exp2(x.z - exponent));
            if (alpha < alpha_cut(is_rain)) continue;
#ifdef OVERDRAW
            fragments += 1.0;
            continue;
#endif
#ifdef LINEAR_RAIN
            if (is_rain) {
                // Of all light that enters the pixel, `share` meets its first drop here.
                float share = open_rain * alpha;
                open_rain -= share;
                shares += share * vec2(open, scene.a);
#ifdef LAMPS
                lamp_light += share * open * colors[k];
#endif
                continue;
            }
#endif
            float weight = alpha * open;
            scene += weight * vec4(colors[k], 1.0);
            open -= weight;
#ifdef WITH_DEPTH
            if (!is_rain) {
                float depth_weight = alpha * open_scene;
                weighted_depth += depth_weight * vec2(x.w, 1.0);
#ifdef LAMPS
                depth_share += depth_weight * x.w / (x.w + 16.0);
#endif
                open_scene -= depth_weight;
            }
#endif
            if (open < MIN_TRANSMITTANCE) open = 0.0;
#ifdef WITH_DEPTH
            done = open_scene < MIN_TRANSMITTANCE;
#else
            done = open == 0.0;
#endif
        }
    }
    if (!inside) return;
#ifdef OVERDRAW
    scene = vec4(fragments);
#endif
#ifdef LENS
    vec4 ray = texelFetch(rays, ivec2(pixel), 0);
#endif
#ifdef MEDIUM
#ifdef LENS
    scene += (1.0 - scene.a) * medium_sky_along(ray.xyz);
#else
    scene += (1.0 - scene.a) * medium_sky(middle, intrinsics);
#endif
#endif
#ifdef LINEAR_RAIN
    scene = with_rain(scene, shares.x, shares.y + open_rain * scene.a, rain_light);
#endif
#ifdef LENS
    scene *= ray.a;
    weighted_depth *= ray.a;
    lamp_light *= ray.a;
#endif
    imageStore(picture, ivec2(pixel), scene);
#ifdef WITH_DEPTH
    imageStore(depths, ivec2(pixel), vec4(weighted_depth, depth_share, 0.0));
#endif
#ifdef LAMPS
    imageStore(lamp_lights, ivec2(pixel), vec4(lamp_light, 0.0));
#endif
}
