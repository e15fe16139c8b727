// Lights without shadows.

void visibility_begin(uint slot, uint pixel) {}

float visibility(uint slot, uint light) { return 1.0; }
