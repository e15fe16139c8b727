// Body of Adam for the visibility field's tables; with PACKED it also stores them in 16 bits for lookups.
#include "common.glsl"
#include "visibility_grid.glsl"
#include "adam.glsl"

layout(constant_id = 0) const uint WORKGROUP = 64;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint FLAGS = 1; // words of `flags`
// Whether an invocation updates one entry, or the entries of one word one after the other. Most words are zero; a CPU
// skips them faster, and a GPU has an invocation for each entry. WORKGROUP is then a multiple of 32.
layout(constant_id = 3) const bool BY_ENTRY = false;

layout(push_constant, scalar) uniform Push {
    uint words; // of `touched`
} push;

layout(scalar) uniform FieldBlock { FieldStep field; } params;

IN(uint, flags);
IN(float, scale);             // of whole numbers, and its inverse
INOUT(uint, touched);         // a bit an entry
INOUT(uint, table_gradients); // entries x 2 x 2
INOUT(float, tables);         // entries x 2
#if PACKED
#include "half.glsl"
OUT(uint, packed_tables);     // entries
#endif
INOUT(vec2, moments);         // entries x 2

#define WHOLE_SUMS table_gradients
#include "whole_sum.glsl"

// Updates an entry, or only clears its gradient.
void update_entry(uint entry, bool allowed) {
    [[dont_unroll]] for (uint i = 2u * entry; i < 2u * entry + 2u; i++) {
        uint low = table_gradients[2u * i], high = table_gradients[2u * i + 1u];
        if ((low | high) == 0u) continue;
        table_gradients[2u * i] = 0u;
        table_gradients[2u * i + 1u] = 0u;
        if (!allowed) continue;
        float parameter = tables[i];
        vec2 m = moments[i];
        adam(parameter, m, whole(low, high) * scale[1], params.field.rate, params.field.correction1,
             params.field.correction2);
        tables[i] = parameter;
        moments[i] = m;
    }
#if PACKED
    if (allowed) packed_tables[entry] = pack_halves(vec2(tables[2u * entry], tables[2u * entry + 1u]));
#endif
}

void main() {
    uint raised = 0u;
    for (uint i = 0u; i < FLAGS; i++) raised |= flags[i];
    uint own = folded_workgroup() * WORKGROUP + gl_LocalInvocationID.x;
    if (BY_ENTRY) {
        uint word = own / 32u;
        uint bits = word < push.words ? touched[word] : 0u;
        // All invocations of a word belong to one workgroup.
        barrier();
        if (bits != 0u && own % 32u == 0u) touched[word] = 0u;
        if ((bits >> (own % 32u) & 1u) != 0u) update_entry(own, raised == 0u);
        return;
    }
    if (own >= push.words) return;
    uint bits = touched[own];
    if (bits == 0u) return;
    touched[own] = 0u;
    [[dont_unroll]] while (bits != 0u) {
        uint entry = own * 32u + uint(findLSB(bits));
        bits &= bits - 1u;
        update_entry(entry, raised == 0u);
    }
}
