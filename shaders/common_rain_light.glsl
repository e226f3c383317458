// Rain's light added to the scene's in linear space (docs/physics/streaks.md). For one streak of alpha a before a scene of
// display color B this is enc((1 - a) dec(B) + a S).

// `scene`: premultiplied, without rain; `rain` and `visible`: shares of rain and scene through each other; `light`: S, linear.
vec4 with_rain(vec4 scene, float rain, float visible, vec3 light) {
    if (!(rain > 0.0)) return scene;
    float transmittance = scene.a > 0.0 ? min(visible / scene.a, 1.0) : 1.0;
    return vec4(linear_to_srgb(transmittance * srgb_to_linear(scene.rgb) + rain * light), rain + visible);
}
