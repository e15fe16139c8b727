// A cube seen through GGX lobes of one roughness, normalized, and the exact adjoint of that (with ADJOINT).
//
// Forward, texel R gets sum_L k(|L - R|^2) area(L) x(L) / sum_L k area. The lobe k depends on the distance alone, so the
// adjoint gathers in the same way: texel L gets area(L) sum_R k(|L - R|^2) g(R) / N(R).
//
// One subgroup makes a block of texels. It goes through the box of texels that the cone around its block covers on each
// face; every lane fetches one texel, and all see them in turn.
#include "cube.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint ROWS = 2;    // of a lane, one below the other
layout(constant_id = 2) const uint COLUMNS = 8; // lanes beside each other

layout(push_constant, scalar) uniform Push {
    uint size;     // texels along a side, of source and destination
    float steep;   // the lobe is (1 - e/2) / (1 + steep e)^2, e = |L - R|^2,
    float cutoff;  // for e up to this,
    float fade;    // and falls to nothing at this rate before it
    float reach;   // the angle of the cutoff
} push;

IN(float, source);        // [6 size^2 * 3]; the adjoint's: gradients times the inverse sums
IN(float, areas);         // [size^2] solid angles
OUT(float, target);       // [6 size^2 * 3]
#ifndef ADJOINT
OUT(float, inverse_sums); // [6 size^2]
#endif

const float PI = 3.14159265358979;
const uint HEIGHT = SUBGROUP / COLUMNS * ROWS;

float coordinate(uint i) { return float(2u * i + 1u) / float(push.size) - 1.0; }

// What a cone of angle `reach` covers of a face along one of its axes; `across` and `depth` are its axis' coordinates.
vec2 covered(float across, float depth, float reach) {
    float length_ = sqrt(across * across + depth * depth), sine = sin(min(reach, 0.5 * PI));
    if (reach >= 0.5 * PI || length_ <= sine) return vec2(-1.0, 1.0);
    float middle = atan(across, depth), half_ = asin(sine / length_);
    float low = middle - half_, high = middle + half_;
    if (low > 0.25 * PI || high < -0.25 * PI) return vec2(2.0, -2.0);
    return vec2(tan(clamp(low, -0.25 * PI, 0.25 * PI)), tan(clamp(high, -0.25 * PI, 0.25 * PI)));
}

// First texel and number of texels, one more than needed at either end.
uvec2 texels_of(vec2 range) {
    float n = float(push.size);
    vec2 at = 0.5 * ((range + 1.0) * n - 1.0);
    int first = max(int(floor(at.x)), 0), last = min(int(ceil(at.y)), int(push.size) - 1);
    return range.x > range.y ? uvec2(0u) : uvec2(uint(first), uint(max(last - first + 1, 0)));
}

void main() {
    uint block = folded_workgroup(), lane = gl_SubgroupInvocationID;
    uint across = push.size / COLUMNS, down = push.size / HEIGHT;
    if (block >= 6u * across * down) return;
    uint face = block / (across * down), x0 = block % across * COLUMNS, y0 = block / across % down * HEIGHT;
    uint x = x0 + lane % COLUMNS, y = y0 + lane / COLUMNS * ROWS;

    vec3 direction[ROWS];
    vec4 sum[ROWS];
    [[unroll]] for (uint k = 0u; k < ROWS; k++) {
        vec3 d = from_face(face, coordinate(x), coordinate(y + k), 1.0);
        direction[k] = d * inversesqrt(dot(d, d));
        sum[k] = vec4(0.0);
    }
    // The cone around the block: its center, and the farthest texel center from there.
    float n = float(push.size);
    vec3 middle = normalize(from_face(face, float(2u * x0 + COLUMNS) / n - 1.0, float(2u * y0 + HEIGHT) / n - 1.0, 1.0));
    float far = 0.0;
    [[unroll]] for (uint k = 0u; k < ROWS; k++) {
        vec3 e = direction[k] - middle;
        far = max(far, dot(e, e));
    }
    far = subgroupMax(far);
    float reach = push.reach + 2.0 * asin(0.5 * sqrt(far)) * 1.001 + 1e-4;

    [[dont_unroll]] for (uint f = 0u; f < 6u; f++) {
        vec2 uv = on_face(middle, f);
        float depth = face_depth(middle, f);
        uvec2 columns = texels_of(covered(uv.x, depth, reach)), rows = texels_of(covered(uv.y, depth, reach));
        uint count = columns.y * rows.y;
        float per_column = 1.0 / float(max(columns.y, 1u));
        for (uint begin = 0u; begin < count; begin += SUBGROUP) {
            uint j = begin + lane;
            bool live = j < count;
            j = min(j, count - 1u);
            // Exact: the fraction is at least half a column away from an integer.
            uint row = uint((float(j) + 0.5) * per_column);
            uint tx = columns.x + j - row * columns.y, ty = rows.x + row;
            vec3 d = from_face(f, coordinate(tx), coordinate(ty), 1.0);
            d *= inversesqrt(dot(d, d));
            uint at = 3u * ((f * push.size + ty) * push.size + tx);
            vec4 value = vec4(source[at], source[at + 1u], source[at + 2u], 1.0);
#ifndef ADJOINT
            value *= areas[ty * push.size + tx];
#endif
            if (!live) value = vec4(0.0);
            [[unroll]] for (uint i = 0u; i < SUBGROUP; i++) {
                vec3 l = vec3(subgroupBroadcast(d.x, i), subgroupBroadcast(d.y, i), subgroupBroadcast(d.z, i));
                vec3 color = vec3(subgroupBroadcast(value.x, i), subgroupBroadcast(value.y, i),
                                  subgroupBroadcast(value.z, i));
#ifdef ADJOINT
                float one = 0.0;
#else
                float one = subgroupBroadcast(value.w, i);
#endif
                [[unroll]] for (uint k = 0u; k < ROWS; k++) {
                    vec3 between = l - direction[k];
                    float e = dot(between, between);
                    float q = 1.0 + push.steep * e;
                    float w = (1.0 - 0.5 * e) * clamp((push.cutoff - e) * push.fade, 0.0, 1.0) / (q * q);
                    sum[k] += w * vec4(color, one);
                }
            }
        }
    }
    [[unroll]] for (uint k = 0u; k < ROWS; k++) {
        uint texel = (face * push.size + y + k) * push.size + x;
#ifdef ADJOINT
        float factor = areas[(y + k) * push.size + x];
#else
        float factor = 1.0 / sum[k].w;
        inverse_sums[texel] = factor;
#endif
        [[unroll]] for (uint c = 0u; c < 3u; c++) target[3u * texel + c] = factor * sum[k][c];
    }
}
