// Iterations of each light and its last relative change, from the progress of transport_step.glsl.

IN(uint, progress);
OUT(uint, convergence); // [lights][2]: iterations, bits of the change

void transport_report(uint light) {
    uint last = 0u;
    for (uint k = 1u; k <= by_workgroup(push.iterations); k++) {
        if (progress[(k + 1u) * push.lights + light] != 0u) last = k;
    }
    uint change = progress[(last + 1u) * push.lights + light];
    convergence[2u * light] = last;
    convergence[2u * light + 1u] = change > 1u ? change : 0u;
}
