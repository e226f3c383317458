// heat_color(t): t = 0..1 as the color map "turbo" (Mikhailov 2019), a polynomial of degree 5 per channel.

vec3 heat_color(float t) {
    t = clamp(t, 0.0, 1.0);
    const vec3 c0 = vec3(0.13572138, 0.09140261, 0.10667330);
    const vec3 c1 = vec3(4.61539260, 2.19418839, 12.64194608);
    const vec3 c2 = vec3(-42.66032258, 4.84296658, -60.58204836);
    const vec3 c3 = vec3(132.13108234, -14.18503333, 110.36276771);
    const vec3 c4 = vec3(-152.94239396, 4.27729857, -89.90310912);
    const vec3 c5 = vec3(59.28637943, 2.82956604, 27.34824973);
    return clamp(c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))), 0.0, 1.0);
}
