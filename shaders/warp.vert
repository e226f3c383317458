#version 410
// Corner of a picture's relief, seen by another camera at another time. The outermost corners are beside the picture,
// for what the camera has turned to.

uniform ivec2 nodes;        // columns and rows, with the outermost ones
uniform float step_px;      // of the grid in the picture
uniform vec2 size_px;       // of the picture
uniform vec4 drawn_lens;    // fx, fy, cx, cy of the picture
uniform mat4 to_camera[MOTIONS];  // from the picture's camera to the present one: what stands still, and each road user
uniform vec4 lens;          // fx, fy, cx, cy of the present camera
uniform vec2 canvas_px;     // its size
uniform float nearest_m;    // depth of its near plane

const float BESIDE = 0.5;   // distance of the outermost corners, in sizes of the picture

in vec2 corner;  // inverse depth in 1/m, number of the road user

out vec2 place;

void main() {
    ivec2 node = ivec2(gl_VertexID % nodes.x, gl_VertexID / nodes.x);
    vec2 at = min(vec2(node - 1) * step_px, size_px);
    place = clamp(at, vec2(0.5), size_px - 0.5) / size_px;
    at += size_px * BESIDE * (vec2(equal(node, nodes - 1)) - vec2(equal(node, ivec2(0))));
    vec4 seen = to_camera[int(corner.y)] * vec4((at - drawn_lens.zw) / drawn_lens.xy, 1.0, corner.x);
    vec2 px = lens.xy * seen.xy + lens.zw * seen.z;
    gl_Position = vec4(2.0 * px / canvas_px - seen.z, seen.z - 2.0 * nearest_m * corner.x, seen.z);
}
