// Hash grid of the visibility field: the table entries of a point, and their weights.
//
// Mueller et al. 2022, section 3: a level is a grid over the box; grids that fit their table are stored densely, the
// others are hashed into it. Corners beyond the last one are clamped to it.

struct FieldLevel {
    float scale;     // grid steps across the box
    uint resolution; // grid points along an axis
    uint offset;     // first entry
    uint mask;       // entries less one where hashed, else 0
};

// What changes from step to step.
struct FieldStep {
    vec3 box_min;      // world
    float jitter;      // standard deviation of the jitter, world units
    vec3 box_max;
    vec3 box_inverse;  // 1 / size of the box
    float regularizer; // weight of one pair's jitter term
    uint pixels;       // of the view
    uint lights;
    uint seed;         // of this step's random numbers
    float rate;        // learning rate
    float correction1; // 1 / (1 - beta^t)
    float correction2;
};

// What is outside of the box counts as on its faces.
vec3 field_inside(FieldStep field, vec3 world) { return clamp(world, field.box_min, field.box_max); }

// Where the box's corners are 0 and 1.
vec3 field_position(FieldStep field, vec3 inside) {
    return clamp((inside - field.box_min) * field.box_inverse, vec3(0.0), vec3(1.0));
}

// Direction from a light, which is zero at the light, and distance, both measured in boxes. Point and light are inside the box,
// in the world, where their difference loses nothing, however close they are.
vec4 field_way(FieldStep field, vec3 point, vec3 light) {
    vec3 way = (point - light) * field.box_inverse;
    float reach = sqrt(dot(way, way));
    return vec4(way * (1.0 / max(reach, 1e-12)), reach);
}

// The cell of a level that a point lies in.
struct FieldCell {
    uvec3 low;
    uvec3 high;
    vec3 part; // of the way from low to high
};

FieldCell field_cell(FieldLevel level, vec3 position) {
    vec3 at = fma(position, vec3(level.scale), vec3(0.5));
    vec3 whole = floor(at);
    uvec3 last = uvec3(level.resolution - 1u);
    uvec3 low = min(uvec3(whole), last);
    return FieldCell(low, min(low + 1u, last), at - whole);
}

// Entry of corner 0 to 7 of a cell, and its weight.
uint field_corner(FieldLevel level, FieldCell cell, uint corner, out float weight) {
    bvec3 up = bvec3((corner & 1u) != 0u, (corner & 2u) != 0u, (corner & 4u) != 0u);
    uvec3 at = mix(cell.low, cell.high, up);
    vec3 w = mix(1.0 - cell.part, cell.part, up);
    weight = w.x * w.y * w.z;
    uint plain = at.x + level.resolution * (at.y + level.resolution * at.z);
    uint hashed = (at.x ^ (at.y * 2654435761u) ^ (at.z * 805459861u)) & level.mask;
    return level.offset + (level.mask != 0u ? hashed : plain);
}
