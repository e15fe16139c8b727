// Lights without shadows.

void visibility_begin(uint slot, uint pixel) {}

float visibility(uint slot, uint light) { return 1.0; }

bool next_light(inout Walk way, out uint light, out vec3 place) { return walk(way, light, place); }
