// Bounds of a fragment's alpha. Much fainter fragments are drawn of rain than of the scene.
const float SCENE_ALPHA_CUT = 1.0 / 255.0;    // as the reference rasterizer (Kerbl et al. 2023)
const float RAIN_ALPHA_CUT = 1.0 / 65536.0;   // a streak's alpha is about 0.01: 1/255 would erase it
const float MAX_ALPHA = 0.999;
const float SURFACE_ALPHA = 0.25;             // a Gaussian's alpha on its "ellipsoid"
