// A projected Gaussian ("splat"): the 32 bytes that the projection pass writes and the drawing pass reads.

struct Splat {
    vec2 center;       // px
    vec2 first_axis;   // one standard deviation (px); the second axis is perpendicular
    float second;      // length of the second axis (px), negative for rain
    float depth;       // along the view axis (m)
    uvec2 appearance;  // display color and largest alpha, four halves
};
