// A projected Gaussian ("splat"): what the projection pass writes and the drawing pass reads.

struct Splat {
    vec4 ellipse;     // centre (px), first axis of one standard deviation (px)
    vec4 extent;      // second axis (px), largest alpha, half side of the quad in standard deviations
    vec4 appearance;  // display colour, view depth (m)
};

// Extent is negative for rain, which keeps much fainter fragments than the scene does.
const float SCENE_ALPHA_CUT = 1.0 / 255.0;    // as the reference rasterizer (Kerbl et al. 2023)
const float RAIN_ALPHA_CUT = 1.0 / 65536.0;   // a streak's alpha is about 0.01: 1/255 would erase it
const float MAX_ALPHA = 0.999;

const uint CULLED = 0xFFFFFFFFu;              // depth key of a Gaussian that is not drawn
