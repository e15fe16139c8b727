// Gradients of the pixels' unit normals: the part across the normal. See lights_pixels.glsl for the preceding definitions.
//
// Unit normals cannot follow the part along the normal; it cancels in highlights and is left out.

layout(push_constant, scalar) uniform Push {
    float normalizer; // 1 / lights at the start
#ifdef BY_STRETCH
    uint block; // first of the stretch
#endif
} push;

IN(vec3, radiance_gradient);
OUT(vec3, normals_gradient);

#include "lights_gradient.glsl"

// The part of one light; `emitted` is the incoming light.
vec3 by_normal(Surface s, vec3 l, Lit r, PixelGradient w, vec3 emitted) {
    float matte = dot(w.matte, emitted);
    float shiny = r.specular * dot(w.gradient * emitted, fresnel_of(w, r.fresnel));
    float by_nl = matte + shiny * (1.0 - r.nl * (s.nv * r.nl * (1.0 - s.a) / r.root_l + s.root_v) / r.q);
    float by_nv = s.facing > NV_MIN ? -r.nl * shiny * (r.root_l + r.nl * s.nv * (1.0 - s.a) / s.root_v) / r.q : 0.0;
    vec3 h = r.inverse * (l + s.view);
    vec3 by_highlight = (-4.0 * r.nl * shiny / r.t) * (s.a * r.nh * h + r.slope);
    return by_nl * l + by_nv * s.view + by_highlight;
}

void main() {
    uint block = folded_workgroup();
#ifdef BY_STRETCH
    block += push.block;
#endif
    uint pixels = pixel_count();
    PixelGradient gradients[PER_LANE];
    vec3 sum[PER_LANE];
    EACH_PIXEL(p) {
        uint pixel = pixel_of(block, p);
        bool here = shaded(pixel, pixels);
        surfaces[p] = load_surface(pixel, here);
        gradients[p] = load_pixel_gradient(pixel, here, push.normalizer);
        sum[p] = vec3(0.0);
        visibility_begin(p, min(pixel, pixels - 1u));
    }
    Walk way = begin_walk();
    uint light;
    vec3 place;
    while (next_light(way, light, place)) {
        Ray rays[PER_LANE];
        vec3 emitted[PER_LANE];
        EACH_PIXEL(p) {
            rays[p] = ray_to(place, surfaces[p].point);
            emitted[p] = vec3(0.0);
        }
        [[dont_unroll]] for (uint k = 0u; k < LOBES; k++) {
            Lobe lobe = load_lobe(light, k);
            EACH_PIXEL(p) {
                vec3 u = lobe.axis.w * rays[p].l - lobe.axis.xyz;
                emitted[p] += exp2(-dot(u, u)) * lobe.amplitude;
            }
        }
        EACH_PIXEL(p) {
            float nl = max(dot(surfaces[p].normal, rays[p].l), 0.0);
            pair_lit = nl > 0.0;
            float seen = visibility(p, light);
            float reaching = pair_lit ? seen * falloff(rays[p]) : 0.0;
            Lit r = lit_by(surfaces[p], rays[p].l, nl);
            sum[p] += by_normal(surfaces[p], rays[p].l, r, gradients[p], reaching * emitted[p]);
        }
    }
    EACH_PIXEL(p) {
        uint pixel = pixel_of(block, p);
        vec3 n = surfaces[p].normal;
        if (pixel < pixels) normals_gradient[pixel] = sum[p] - dot(n, sum[p]) * n;
    }
}
