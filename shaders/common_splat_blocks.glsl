// Splats in storage blocks, for shaders that read (SPLAT_ACCESS readonly) or write them; needs common_splat.glsl.

// Splats lie in blocks of 2^BLOCK_SHIFT, as many as a driver's storage block may hold.
layout(std430, binding = 8) SPLAT_ACCESS buffer Splats0 { Splat splats0[]; };
#if SPLAT_BLOCKS > 1
layout(std430, binding = 9) SPLAT_ACCESS buffer Splats1 { Splat splats1[]; };
#endif
#if SPLAT_BLOCKS > 2
layout(std430, binding = 10) SPLAT_ACCESS buffer Splats2 { Splat splats2[]; };
#endif
#if SPLAT_BLOCKS > 3
layout(std430, binding = 11) SPLAT_ACCESS buffer Splats3 { Splat splats3[]; };
#endif

#ifdef LOADS_SPLATS
Splat load_splat(uint slot) {
    uint place = slot & ((1u << BLOCK_SHIFT) - 1u);
    switch (slot >> BLOCK_SHIFT) {
#if SPLAT_BLOCKS > 1
        case 1u: return splats1[place];
#endif
#if SPLAT_BLOCKS > 2
        case 2u: return splats2[place];
#endif
#if SPLAT_BLOCKS > 3
        case 3u: return splats3[place];
#endif
        default: return splats0[place];
    }
}
#endif
