// Walks the splats of a tile front to back as blend.comp does, with the same arithmetic.
//
// Passes every contributing (pixel, splat) pair to VISIT(k, pixel, v, w): number of the lane's pixel, its index in the
// view, visible splat, blending weight. FINISH(k, pixel) follows for every pixel of the view. Needs the constants and
// buffers of blend.comp, tile.glsl and sub_tiles.glsl.

void visit_blend() {
    Camera camera = params.step.camera;
    Tile tile = this_tile(camera);
    if (tile.index >= camera.tiles.x * camera.tiles.y) return;
    float px = float(tile.first.x) + 0.5;
    float py = float(tile.first.y) + 0.5;
    float T[PER_LANE];
    bool inside[PER_LANE];
    uint pixel[PER_LANE];
    [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
        uvec2 at = tile.first + slot_corner(k);
        inside[k] = all(lessThan(at, camera.size));
        pixel[k] = inside[k] ? at.y * camera.size.x + at.x : 0u;
        T[k] = 1.0;
        START(k, pixel[k])
    }
    uint begin = tile_ranges[2u * tile.index], end = tile_ranges[2u * tile.index + 1u];
    for (uint batch = begin; batch < end; batch += SUBGROUP) {
        float best = -1.0;
        [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) best = max(best, T[k]);
        if (subgroupAll(best < 0.0)) break;
        uint mine = min(batch + gl_SubgroupInvocationID, end - 1u);
        uint v = entry_splats[sorted_entries[mine]];
        Splat s = splats[v];
        uint own_slots = touched_slots(s, vec2(tile.corner) + 0.5);
        uint count = min(SUBGROUP, end - batch);
        for (uint i = 0u; i < count; ++i) {
            float mx = subgroupShuffle(s.mean.x, i), my = subgroupShuffle(s.mean.y, i);
            float u11 = subgroupShuffle(s.factor.x, i), u12 = subgroupShuffle(s.factor.y, i);
            float u22 = subgroupShuffle(s.factor.z, i), opacity = subgroupShuffle(s.opacity, i);
            uint splat = subgroupShuffle(v, i);
            uint slots = subgroupShuffle(own_slots, i);
            [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
                if (!in_slots(slots, k)) continue;
                vec2 offset = vec2(slot_corner(k));
                float dx = px + offset.x - mx, dy = py + offset.y - my;
                float p = u11 * dx + u12 * dy;
                float q = u22 * dy;
                float alpha = min(ALPHA_MAX, opacity * exp2(-(p * p + q * q)));
                alpha = alpha >= ALPHA_MIN && T[k] > 0.0 ? alpha : 0.0;
                float next = T[k] - alpha * T[k];
                bool stop = alpha > 0.0 && next < TRANSMITTANCE_MIN;
                float w = stop && !KEEP_LAST ? 0.0 : alpha * T[k];
                if (w > 0.0 && inside[k]) { VISIT(k, pixel[k], splat, w) }
                T[k] = stop ? -(KEEP_LAST ? next : T[k]) : next;
            }
        }
    }
    [[unroll]] for (uint k = 0u; k < PER_LANE; ++k) {
        if (inside[k]) { FINISH(k, pixel[k]) }
    }
}
