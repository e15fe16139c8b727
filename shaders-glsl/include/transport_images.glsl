// Images of values by receiver: a texel for each receiver and one more, which is zero. The images of the lights lie one below
// the other. Loads of texels are faster than those of buffers on CPUs, which load a buffer's words lane by lane.

const uint TRANSPORT_WIDTH = 256u;

// `rows`: height of a light's image.
ivec2 transport_texel(uint receiver, uint light, uint rows) {
    return ivec2(receiver % TRANSPORT_WIDTH, light * rows + receiver / TRANSPORT_WIDTH);
}
