// Shadows from the stored results of lights_trace, for a range of the view's pixels.
//
// See lights_pixels.glsl for the three functions. The bodies read the range where BY_STRETCH is defined, and a kernel
// declares its beginning after them:
//     uint stretch_first() { return push.stretch_first; }

#define BY_STRETCH

layout(constant_id = 8) const uint STRETCH = 4; // pixels from one light's to the next one's

IN(uint, seen);

uint stretch_first(); // pixel

uint seen_at[PER_LANE];

void visibility_begin(uint slot, uint pixel) { seen_at[slot] = max(pixel, stretch_first()) - stretch_first(); }

float visibility(uint slot, uint light) {
    uint byte = light * STRETCH + seen_at[slot];
    return float(bitfieldExtract(seen[byte / 4u], int(8u * (byte & 3u)), 8)) * (1.0 / 255.0);
}

bool next_light(inout Walk way, out uint light, out vec3 place) { return walk(way, light, place); }
