// Radiance towards the camera under all lights. See lights_pixels.glsl for the preceding definitions.
//
// With SUMS 1 it stores the material-independent sums for gradients of materials: 6 floats a pixel, 12 with metallic. With
// SPLIT 1 it also stores the diffuse part.

layout(push_constant, scalar) uniform Push {
    float normalizer; // 1 / lights at the start
#ifdef BY_STRETCH
    uint block; // first of the stretch
#endif
} push;

OUT(vec3, direct);
#if SUMS
OUT(vec3, sums); // irradiance; radiance by roughness; with metallic: specular sums with 1 - c and with c
#endif
#if SPLIT
OUT(vec3, diffuse);
#endif

void main() {
    uint block = folded_workgroup();
#ifdef BY_STRETCH
    block += push.block;
#endif
    uint pixels = pixel_count();
    vec3 f0[PER_LANE];
    float f90[PER_LANE];
    vec3 irradiance[PER_LANE], plain[PER_LANE], grazing[PER_LANE], by_roughness[PER_LANE];
    EACH_PIXEL(p) {
        uint pixel = pixel_of(block, p);
        bool here = shaded(pixel, pixels);
        surfaces[p] = load_surface(pixel, here);
        f0[p] = vec3(0.04);
        f90[p] = 1.0;
        if (METALLIC && here) {
            f0[p] = fresnel0(materials[pixel].rgb, metallic[pixel]);
            f90[p] = fresnel90(f0[p]);
        }
        irradiance[p] = plain[p] = grazing[p] = by_roughness[p] = vec3(0.0);
        visibility_begin(p, min(pixel, pixels - 1u));
    }
    Walk way = begin_walk();
    uint light;
    vec3 place;
    while (next_light(way, light, place)) {
        vec3 l[PER_LANE], emitted[PER_LANE];
        float nl[PER_LANE], weight[PER_LANE];
        EACH_PIXEL(p) {
            Ray ray = ray_to(place, surfaces[p].point);
            l[p] = ray.l;
            // Zero where the light is behind: every sum below then stays as it is.
            nl[p] = max(dot(surfaces[p].normal, ray.l), 0.0);
            weight[p] = nl[p] * falloff(ray);
            emitted[p] = vec3(0.0);
        }
        [[dont_unroll]] for (uint k = 0u; k < LOBES; k++) {
            Lobe lobe = load_lobe(light, k);
            EACH_PIXEL(p) {
                vec3 u = lobe.axis.w * l[p] - lobe.axis.xyz;
                emitted[p] += exp2(-dot(u, u)) * lobe.amplitude;
            }
        }
        EACH_PIXEL(p) {
            pair_lit = nl[p] > 0.0;
            vec3 e = weight[p] * visibility(p, light) * emitted[p];
            Lit r = lit_by(surfaces[p], l[p], nl[p]);
            float c = r.fresnel;
            irradiance[p] += e;
            plain[p] += r.specular * (1.0 - c) * e;
            grazing[p] += r.specular * c * e;
#if SUMS
            vec3 fresnel = METALLIC ? mix(f0[p], vec3(f90[p]), c) : vec3(0.04 + 0.96 * c);
            by_roughness[p] += r.specular * by_alpha(surfaces[p], r) * fresnel * e;
#endif
        }
    }
    EACH_PIXEL(p) {
        uint pixel = pixel_of(block, p);
        if (pixel < pixels) {
            float metal = 0.0;
            if (METALLIC) metal = metallic[pixel];
            // What is not shaded has no light, and its material may be anything.
            vec3 albedo = shaded(pixel, pixels) ? materials[pixel].rgb : vec3(0.0);
            if (!shaded(pixel, pixels)) metal = 0.0;
            vec3 matte = push.normalizer * (1.0 - metal) / PI * albedo * irradiance[p];
            vec3 glossy = push.normalizer * (f0[p] * plain[p] + f90[p] * grazing[p]);
            direct[pixel] = matte + glossy;
#if SUMS
            uint to = (METALLIC ? 4u : 2u) * pixel;
            sums[to] = push.normalizer * irradiance[p];
            sums[to + 1u] = push.normalizer * alpha_by_roughness(surfaces[p]) * by_roughness[p];
            if (METALLIC) {
                sums[to + 2u] = push.normalizer * plain[p];
                sums[to + 3u] = push.normalizer * grazing[p];
            }
#endif
#if SPLIT
            diffuse[pixel] = matte;
#endif
        }
    }
}
