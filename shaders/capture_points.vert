#version 410
// Measured points of a capture (COLMAP, lidar), a few pixels each.
// In: positions in the capture's world and sRGB colors; a camera with OpenCV axes (x right, y down, z forward).
// No races: no thread writes but its own vertex, and the depth test decides which of two dots is in front.

uniform mat4 capture_to_camera;
uniform vec2 focal_px;
uniform vec2 center_px;
uniform vec2 image_size;
uniform float near_m;
uniform float size_px;

in vec3 position;
in vec3 color;

out vec3 point_color;

void main() {
    vec3 placed = (capture_to_camera * vec4(position, 1.0)).xyz;
    vec2 pixel = focal_px * placed.xy + center_px * placed.z;  // homogeneous, of w = z
    // Row 0 of the target is the picture's first row. Depth grows from -1 at the near plane to 1 at infinity.
    gl_Position = vec4(2.0 * pixel / image_size - placed.z, placed.z - 2.0 * near_m, placed.z);
    gl_PointSize = size_px;
    point_color = color;
}
