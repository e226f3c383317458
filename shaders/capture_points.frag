#version 410
// A round dot in the point's color; nothing around it.

in vec3 point_color;

out vec4 fragment;

void main() {
    vec2 offset = 2.0 * gl_PointCoord - 1.0;
    if (dot(offset, offset) > 1.0) {
        discard;
    }
    fragment = vec4(point_color, 1.0);
}
