// Tests for finite numbers.

// By the exponent's bits: compilers may assume that isnan() and isinf() are never true.
bool finite_bits(float x) { return (floatBitsToUint(x) & 0x7f800000u) != 0x7f800000u; }

bool finite_bits(vec3 v) { return finite_bits(v.x) && finite_bits(v.y) && finite_bits(v.z); }
