// Slots of a tile, or of a part of it, that a splat can touch, a bit each. Included after splat.glsl and tile.glsl.
//
// A splat shows at some pixels of its tile only. Each lane finds the slots of the splat that it fetched, and hands the bits on
// with the splat, so branches by them are uniform in the subgroup. The test is conservative by far more than rounding: in
// a slot that it leaves out every alpha is below ALPHA_MIN, so skipping it changes no bit. passes/src/reference/sub_tiles.rs
// is its reference.

layout(constant_id = 32) const float SLOT_MARGIN = 0.05; // of the exponent; a huge one leaves every slot in
const float SLOT_GAP = 0.0625;    // pixels around a slot
const float SLOT_SLOPE_MAX = 1e5; // thinner splats are tried in every slot

// A slot is a rectangle. The footprint within its rows is convex, so it meets the rectangle if their ranges of x overlap.
// In q the right edge is -slope q + sqrt(limit - q²), over factor.x, a concave function whose maximum lies at -steepest.
uint touched_slots(Splat s, vec2 corner) {
    if (!SUB_TILES) return 0xffffffffu;
    float limit = max(log2(s.opacity / ALPHA_MIN), 0.0) + SLOT_MARGIN;
    float reach = sqrt(limit);
    float slope = s.factor.y / s.factor.z, wide = 1.0 / s.factor.x;
    float steepest = reach * slope * inversesqrt(1.0 + slope * slope);
    vec2 start = corner - s.mean - SLOT_GAP;
    uint slots = 0u;
    [[unroll]] for (uint row = 0u; row < PART_HEIGHT / SLOT_HEIGHT; ++row) {
        float top = start.y + float(row * SLOT_HEIGHT);
        float q0 = s.factor.z * top, q1 = s.factor.z * (top + (float(SLOT_HEIGHT - 1u) + 2.0 * SLOT_GAP));
        float right_q = clamp(-steepest, q0, q1), left_q = clamp(steepest, q0, q1);
        float right = wide * (sqrt(max(limit - right_q * right_q, 0.0)) - slope * right_q);
        float left = wide * (-sqrt(max(limit - left_q * left_q, 0.0)) - slope * left_q);
        bool outside = q0 > reach || q1 < -reach;
        [[unroll]] for (uint column = 0u; column < SLOTS_ACROSS; ++column) {
            float x0 = start.x + float(column * SLOT_WIDTH);
            float x1 = x0 + (float(SLOT_WIDTH - 1u) + 2.0 * SLOT_GAP);
            // Comparisons with what is not a number leave the slot in.
            bool out_of_slot = outside || x0 > right || x1 < left;
            slots |= uint(!out_of_slot) << (row * SLOTS_ACROSS + column);
        }
    }
    return abs(slope) < SLOT_SLOPE_MAX ? slots : 0xffffffffu;
}

bool in_slots(uint slots, uint k) { return !SUB_TILES || (slots & (1u << k)) != 0u; }
