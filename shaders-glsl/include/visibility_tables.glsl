// Lookup of the visibility field's tables: two numbers an entry, or with TABLE_BITS 16 a word of two halves. One buffer
// is bound to both.

#include "half.glsl"

layout(constant_id = 30) const uint TABLE_BITS = 32;

IN(vec2, tables);
IN(uint, packed_tables);

vec2 table_entry(uint entry) {
    if (TABLE_BITS == 16u) return unpack_halves(packed_tables[entry]);
    return tables[entry];
}
