// Box around a scene. Its faces are cut into cells, the patches, numbered face by face: low x, high x, low y, high y, low z,
// high z. On a face, cells are numbered along the next axis (x, y, z, x, ...) first, then along the one after it.

struct EnclosureBox {
    vec3 low;
    vec3 high;
    uvec3 cells; // along each axis
};

// Cell of a coordinate among `cells` that fill `low` to `high`; the nearest one outside of these.
uint enclosure_cell(float at, float low, float high, uint cells) {
    float share = (at - low) / (high - low) * float(cells);
    return share > 0.0 ? min(uint(min(share, 1e9)), cells - 1u) : 0u;
}

// Patch in which a ray leaves the box. A point outside is moved to the nearest one of the box.
uint enclosure_exit(EnclosureBox box, vec3 from, vec3 along) {
    vec3 inside = min(max(from, box.low), box.high);
    uint axis = 0u;
    float reach = uintBitsToFloat(0x7f7fffffu);
    [[unroll]] for (uint k = 0u; k < 3u; k++) {
        float wall = along[k] > 0.0 ? box.high[k] : box.low[k];
        float at = along[k] != 0.0 ? (wall - inside[k]) / along[k] : reach;
        if (at < reach) {
            reach = at;
            axis = k;
        }
    }
    uint u = axis == 2u ? 0u : axis + 1u, v = axis == 0u ? 2u : axis - 1u;
    uint face = 2u * axis + (along[axis] > 0.0 ? 1u : 0u);
    // Cells of the faces before this one.
    uvec3 sizes = box.cells.yzx * box.cells.zxy;
    uint first = (axis > 0u ? 2u * sizes.x : 0u) + (axis > 1u ? 2u * sizes.y : 0u) + (face & 1u) * sizes[axis];
    uint cell_u = enclosure_cell(inside[u] + reach * along[u], box.low[u], box.high[u], box.cells[u]);
    uint cell_v = enclosure_cell(inside[v] + reach * along[v], box.low[v], box.high[v], box.cells[v]);
    return first + cell_u + box.cells[u] * cell_v;
}
