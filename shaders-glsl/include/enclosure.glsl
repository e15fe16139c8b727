// Box around a scene. Its faces are cut into cells, the patches, numbered face by face: low x, high x, low y, high y, low z,
// high z. On a face, cells are numbered along the next axis (x, y, z, x, ...) first, then along the one after it.

struct EnclosureBox {
    vec3 low;
    vec3 high;
    uvec3 cells; // along each axis
};

// Where a ray leaves the box.
struct EnclosureExit {
    uint first;  // first patch of the face
    uvec2 cells; // of the face
    vec2 place;  // on the face, in cells
};

// A point outside of the box is moved to the nearest one in it.
EnclosureExit enclosure_leave(EnclosureBox box, vec3 from, vec3 along) {
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
    float place_u = (inside[u] + reach * along[u] - box.low[u]) / (box.high[u] - box.low[u]) * float(box.cells[u]);
    float place_v = (inside[v] + reach * along[v] - box.low[v]) / (box.high[v] - box.low[v]) * float(box.cells[v]);
    return EnclosureExit(first, uvec2(box.cells[u], box.cells[v]), vec2(place_u, place_v));
}

// Cell of a place among `cells`; the nearest one outside of these.
uint enclosure_cell(float place, uint cells) {
    return place > 0.0 ? min(uint(min(place, 1e9)), cells - 1u) : 0u;
}

// Patch in which a ray leaves the box.
uint enclosure_exit(EnclosureBox box, vec3 from, vec3 along) {
    EnclosureExit e = enclosure_leave(box, from, along);
    return e.first + enclosure_cell(e.place.x, e.cells.x) + e.cells.x * enclosure_cell(e.place.y, e.cells.y);
}
