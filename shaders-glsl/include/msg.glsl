// Levels of the multi-scale gradient loss: their sizes, their offsets, and the results that its backward needs.

const uint LEVELS = 4;

// Pixels of albedo and roughness that have something to be compared with, as bits.
const uint HAS_ALBEDO = 1, HAS_ROUGHNESS = 2;

// From the sums: factors of the slopes (albedo, roughness) level by level, and of twice the difference; the losses.
struct MsgLevels {
    vec2 factors[4];
    float square_factor;
    float albedo;     // mean over the levels, before weights
    float roughness;  // likewise
    float square;     // sum over channels of the squared difference, mean over pixels that count
    float pixels;     // that count
};

uvec2 level_size(uvec2 size, uint level) { return max(size >> level, uvec2(1u)); }

// Columns and rows of image pixels that a pixel of a level covers.
vec2 level_scale(uvec2 size, uint level) { return vec2(size) / vec2(level_size(size, level)); }

// Level of an element of all levels, and its number there. LEVELS if it is in none.
uint level_of(uvec2 size, uint element, out uint there) {
    uint level = 0u;
    there = element;
    [[unroll]] for (uint k = 0u; k < LEVELS; k++) {
        uvec2 s = level_size(size, k);
        bool beyond = level == k && there >= s.x * s.y;
        there -= beyond ? s.x * s.y : 0u;
        level += beyond ? 1u : 0u;
    }
    return level;
}

// First pixel of a level behind those before it.
uint level_first(uvec2 size, uint level) {
    uint first = 0u;
    [[unroll]] for (uint k = 0u; k < LEVELS; k++) {
        uvec2 s = level_size(size, k);
        first += k < level ? s.x * s.y : 0u;
    }
    return first;
}

uvec2 level_tiles(uvec2 size, uint level, uvec2 tile) { return (level_size(size, level) + tile - 1u) / tile; }

// The tent over pixels from `first` to `end` around a level's pixel.
struct Tent {
    float center, scale;
    int first, end;
};

Tent tent_of(uint at, float scale, uint size) {
    float center = (float(at) + 0.5) * scale;
    return Tent(center, scale, max(int(floor(center - scale)), 0), min(int(ceil(center + scale)), int(size)));
}

float tent_weight(Tent t, int at) { return max(1.0 - abs(float(at) + 0.5 - t.center) / t.scale, 0.0); }

float tent_total(Tent t) {
    float total = 0.0;
    for (int i = t.first; i < t.end; i++) total += tent_weight(t, i);
    return total;
}
