// Buckets: runs of BUCKET entries of a tile, which blend_bwd_bucket works on side by side.
//
// Bucket b of tile t has the slot begin / BUCKET + t + b, where `begin` is the tile's first entry. Slots of different tiles
// differ without a prefix sum: a tile has at most end / BUCKET - begin / BUCKET + 1 buckets, and the next one begins at
// `end` or later. A slot holds a mark for each part of a tile: the tile, or NO_TILE if no bucket has the slot. Needs
// CHANNELS, PIXELS (of a tile) and parts.glsl.
//
// A checkpoint holds the state of the tile's pixels before a bucket: transmittance, negative once the pixel has stopped,
// and the sums of the channels. A tile's first bucket needs none, and neither do parts with the mark UNREACHED.

layout(constant_id = 28) const uint BUCKET = 64; // entries, a multiple of the subgroup

const uint NO_TILE = 0xffffffffu;
const uint UNREACHED = 0x80000000u; // all pixels of the part had stopped before the bucket

uint bucket_count(uint begin, uint end) { return (end - begin + BUCKET - 1u) / BUCKET; }

uint first_bucket(uint begin, uint tile) { return begin / BUCKET + tile; }

// Where the mark of a part lies.
uint bucket_mark(uint slot, uint part) { return slot * TILE_PARTS + part; }

// Where a pixel's transmittance lies; channel c follows (1 + c) * PIXELS later. `bucket`: in its tile, not the first;
// `pixel`: in its tile, by rows.
uint checkpoint(uint begin, uint bucket, uint pixel) {
    return (begin / BUCKET + bucket - 1u) * (1u + CHANNELS) * PIXELS + pixel;
}
