// Gradients of surfels' materials, of the faces' albedo and of the lights' colors from those of reflectance and source.
//
// A workgroup, which is one subgroup, takes a range of blocks of receivers, a receiver a lane, and sums the gradients of
// colors and faces over them in a row of its own. Rows are summed afterwards, in order (lights_reduce).
#version 460
#include "common.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;

#include "transport_source.glsl"

layout(push_constant, scalar) uniform Push {
    uint receivers; // surfels, then patches
    uint surfels;
    uint lights;
    uint blocks;    // of a workgroup
    uint workgroups;
} push;

IN(vec3, reflectance_gradient); // [receivers]
IN(vec3, source_gradient);      // [receivers]
OUT(vec4, materials_gradient);  // [surfels]
OUT(float, metallic_gradient);  // [surfels], with METALLIC
INOUT(float, partials);         // [workgroups * (lights + 6) * 3], zeros to begin with

const uint FACES = 6u;

void add(uint row, uint at, vec3 value) {
    vec3 sum = vec3(subgroupAdd(value.r), subgroupAdd(value.g), subgroupAdd(value.b));
    uint lane = gl_SubgroupInvocationID;
    if (lane < 3u) partials[row + 3u * at + lane] += lane == 0u ? sum.r : lane == 1u ? sum.g : sum.b;
}

void main() {
    if (folded_workgroup() >= push.workgroups) return;
    uint row = folded_workgroup() * (push.lights + FACES) * 3u, lane = gl_SubgroupInvocationID;
    for (uint block = 0u; block < by_workgroup(push.blocks); block++) {
        uint first = (folded_workgroup() * push.blocks + block) * SUBGROUP, i = first + lane;
        bool here = i < push.receivers, surfel = i < push.surfels;
        Reflectance rho = Reflectance(vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0));
        uint face = FACES;
        vec3 albedo = vec3(0.0);
        if (surfel) {
            rho = reflectance_of(materials[i].rgb, materials[i].w, METALLIC ? metallic[i] : 0.0);
        } else if (here) {
            face = faces[i - push.surfels];
            albedo = face_albedo(face);
            rho.value = min(albedo + SHEEN, vec3(1.0));
        }
        vec3 by_source = here ? source_gradient[i] : vec3(0.0), direct = vec3(0.0);
        for (uint light = 0u; light < by_workgroup(push.lights); light++) {
            vec3 color = exp(log_colors[light]);
            float reaching = here ? unit[light * push.receivers + i] : 0.0;
            direct += reaching * color;
            add(row, light, reaching * rho.value * by_source / PI);
        }
        vec3 by_rho = (here ? reflectance_gradient[i] : vec3(0.0)) + by_source * direct / PI;
        // Blocks of surfels alone have no faces. The condition is the same for all lanes.
        if (first + SUBGROUP > push.surfels) {
            vec3 by_face = by_rho * vec3(lessThan(albedo + SHEEN, vec3(1.0))) * albedo * (1.0 - albedo);
            [[unroll]] for (uint f = 0u; f < FACES; f++) add(row, push.lights + f, face == f ? by_face : vec3(0.0));
        }
        if (surfel) {
            materials_gradient[i] = vec4(by_rho * rho.by_albedo, dot(by_rho, rho.by_roughness));
            if (METALLIC) metallic_gradient[i] = dot(by_rho, rho.by_metallic);
        }
    }
}
