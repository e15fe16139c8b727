// Tiles of large splats, found by the lanes of a subgroup together, in the order in which one lane walks them: by rows.
// Included after splat.glsl and large_splats.glsl; needs TILE_WIDTH and TILE_HEIGHT.

// A footprint and the pixels around it; an empty box has no tiles.
struct Footprint {
    Splat splat;
    float limit;
    PixelBox box;
};

// The number of tiles in the box decides: the number of those touched is not known before they are walked.
bool is_large(Footprint f) {
    if (box_is_empty(f.box)) return false;
    ivec2 size = ivec2(TILE_WIDTH, TILE_HEIGHT);
    ivec2 tiles = f.box.high / size - f.box.low / size + 1;
    return uint(tiles.x) * uint(tiles.y) > LARGE_TILES;
}

Footprint footprint_of_lane(Footprint f, uint lane) {
    Footprint o;
    o.splat.mean = subgroupShuffle(f.splat.mean, lane);
    o.splat.factor = subgroupShuffle(f.splat.factor, lane);
    o.splat.opacity = subgroupShuffle(f.splat.opacity, lane);
    o.limit = subgroupShuffle(f.limit, lane);
    o.box = PixelBox(subgroupShuffle(f.box.low, lane), subgroupShuffle(f.box.high, lane));
    return o;
}

// What the tiles of one row share: their span, and the pixels of the row nearest to the center, which `splat_touches`
// tries first. In the interior of a large splat that row answers for every tile.
struct TileRow {
    ivec2 span;
    ivec2 nearest;
};

TileRow tile_row(Footprint f, int ty) {
    int y0 = ty * int(TILE_HEIGHT), y1 = y0 + int(TILE_HEIGHT) - 1;
    TileRow row;
    row.span = splat_tile_span(f.splat, f.limit, f.box, y0, y1, int(TILE_WIDTH));
    int y = clamp(splat_center_row(f.splat), max(y0, f.box.low.y), max(y0, min(y1, f.box.high.y)));
    row.nearest = splat_row(f.splat, f.limit, y);
    return row;
}

bool tile_is_touched(Footprint f, TileRow row, int ty, int tx) {
    if (tx > row.span.y) return false;
    if (tx == row.span.x || tx == row.span.y) return true;
    int x0 = tx * int(TILE_WIDTH), x1 = x0 + int(TILE_WIDTH) - 1;
    if (max(row.nearest.x, x0) <= min(row.nearest.y, x1)) return true;
    int y0 = ty * int(TILE_HEIGHT);
    return splat_touches(f.splat, f.limit, x0, x1, max(y0, f.box.low.y), min(y0 + int(TILE_HEIGHT) - 1, f.box.high.y));
}

// Runs ACTION for every SUBGROUP tiles of a row: `ty` is the row, `tx` this lane's tile, `touched` whether it is one.
// The footprint must be the same in all lanes. Each lane finds the span of one row, then all lanes walk each span.
#define WALK_TILES(f, ACTION)                                                                                  \
    {                                                                                                          \
        int last_ = f.box.high.y / int(TILE_HEIGHT);                                                           \
        for (int first_ = f.box.low.y / int(TILE_HEIGHT); first_ <= last_; first_ += int(SUBGROUP)) {          \
            TileRow own_ = tile_row(f, first_ + int(gl_SubgroupInvocationID));                                 \
            for (int r_ = 0; r_ < min(int(SUBGROUP), last_ - first_ + 1); ++r_) {                              \
                TileRow row_ = TileRow(subgroupShuffle(own_.span, uint(r_)),                                   \
                                       subgroupShuffle(own_.nearest, uint(r_)));                               \
                int ty = first_ + r_;                                                                          \
                for (int start_ = row_.span.x; start_ <= row_.span.y; start_ += int(SUBGROUP)) {               \
                    int tx = start_ + int(gl_SubgroupInvocationID);                                            \
                    bool touched = tile_is_touched(f, row_, ty, tx);                                           \
                    ACTION                                                                                     \
                }                                                                                              \
            }                                                                                                  \
        }                                                                                                      \
    }
