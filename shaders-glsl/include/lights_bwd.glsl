// Gradients of the lights: of their positions, and of each lobe's axis, sharpness and amplitudes. See lights_pixels.glsl
// for the preceding definitions.
//
// A workgroup, which is one subgroup, takes a range of blocks of pixels and recomputes everything from the pixels' side.
// Light by light and lobe by lobe it sums seven numbers over its pixels, first within the lanes, then across them by
// halving, and stores the sums in a row of its own. Rows are summed afterwards, in order. With MINE the row is in the
// invocations' own arrays, which software devices access far faster than buffers.
//
// A light's part of a row: 3 sums for its position and 5 zeros; for each lobe 8 numbers: sum t u (3), sum t |u|^2,
// sum w s (3), 0, with u = root l - root b, s = 2^-|u|^2, w the gradient of the radiance by the emitted light,
// t = (w . mu) s.

layout(constant_id = 5) const uint LIGHTS = 64;
layout(constant_id = 6) const bool MINE = false; // only where SUBGROUP is 8

#include "lane_sums.glsl"

layout(push_constant, scalar) uniform Push {
    float normalizer; // 1 / lights at the start
    uint blocks;      // of a workgroup
#ifdef BY_STRETCH
    uint block; // first of the stretch
    uint end;   // behind its last
    uint row;   // first of its workgroups' rows
#endif
} push;

IN(vec3, radiance_gradient);
INOUT(float, partials); // workgroups x LIGHTS x 8 (1 + LOBES)

#include "lights_gradient.glsl"

const uint LIGHT_ROW = 8u * (1u + LOBES);
const uint GROUP = SUBGROUP / 8u;                    // lobes whose sums are added up across lanes at once
const uint GROUPS = (LOBES + GROUP - 1u) / GROUP;

float mine[MINE ? LIGHTS * (1u + LOBES) : 1u]; // lane j has number j of every eight

#ifdef BY_STRETCH
uint row_start() { return (push.row + folded_workgroup()) * LIGHTS * LIGHT_ROW; }
#else
uint row_start() { return folded_workgroup() * LIGHTS * LIGHT_ROW; }
#endif

// Adds a number of each lane to a light's part of the row, from `at` on; lanes from `lanes` on have none.
void keep(uint light, uint at, uint lanes, float value) {
    if (MINE) {
        mine[light * (1u + LOBES) + at / 8u] += value;
    } else if (gl_SubgroupInvocationID < lanes) {
        partials[row_start() + light * LIGHT_ROW + at + gl_SubgroupInvocationID] += value;
    }
}

void write_row() {
    if (!MINE) return;
    [[dont_unroll]] for (uint i = 0u; i < LIGHTS * (1u + LOBES); i++) {
        partials[row_start() + 8u * i + (gl_SubgroupInvocationID & 7u)] = mine[i];
    }
}

// Gradient of the radiance by the light's place. `emitted` is the incoming light, `turn` its derivative by the direction.
vec3 position_gradient_of(Surface s, Ray ray, Lit r, PixelGradient w, vec3 emitted, vec3 turn) {
    vec3 glossy = w.gradient * emitted;
    float matte = dot(w.matte, emitted);
    float shiny = r.specular * dot(glossy, fresnel_of(w, r.fresnel));
    float edge = METALLIC ? dot(glossy, vec3(w.f90) - w.f0) : 0.96 * (glossy.r + glossy.g + glossy.b);
    float by_nl = matte + shiny * (1.0 - r.nl * (s.nv * r.nl * (1.0 - s.a) / r.root_l + s.root_v) / r.q);
    float m = 1.0 - min(r.lh, 1.0);
    float by_half = -1.25 * r.nl * r.specular * edge * m * m * m * m / max(r.lh, 1e-4);
    float by_slope = 4.0 * r.nl * shiny * (1.0 - s.a) * r.nh * r.inverse / r.t;
    vec3 g = by_nl * s.normal + by_slope * r.slope + by_half * s.view + turn;
    float nearer = ray.square > NEAR_SQUARED ? 2.0 * r.nl * (matte + shiny) : 0.0;
    return ray.inverse * (g - (dot(g, ray.l) + nearer) * ray.l);
}

void main() {
    uint pixels = pixel_count();
    uint blocks = (pixels + SUBGROUP * PER_LANE - 1u) / (SUBGROUP * PER_LANE);
    uint first = folded_workgroup() * by_workgroup(push.blocks);
#ifdef BY_STRETCH
    blocks = min(blocks, by_workgroup(push.end));
    first += push.block;
#endif
    if (row_start() >= partials.length()) return; // only there because the grid is folded
    // The rows in the buffer are zeros to begin with.
    if (MINE) {
        [[dont_unroll]] for (uint i = 0u; i < LIGHTS * (1u + LOBES); i++) mine[i] = 0.0;
    }
    for (uint block = first; block < min(first + push.blocks, blocks); block++) {
        PixelGradient gradients[PER_LANE];
        EACH_PIXEL(p) {
            uint pixel = pixel_of(block, p);
            bool here = shaded(pixel, pixels);
            surfaces[p] = load_surface(pixel, here);
            gradients[p] = load_pixel_gradient(pixel, here, push.normalizer);
            visibility_begin(p, min(pixel, pixels - 1u));
        }
        Walk way = begin_walk();
        uint light;
        vec3 place;
        while (next_light(way, light, place)) {
            Ray rays[PER_LANE];
            Lit lits[PER_LANE];
            float reaching[PER_LANE];
            vec3 weight[PER_LANE], emitted[PER_LANE], turn[PER_LANE];
            EACH_PIXEL(p) {
                rays[p] = ray_to(place, surfaces[p].point);
                float nl = max(dot(surfaces[p].normal, rays[p].l), 0.0);
                pair_lit = nl > 0.0;
                float seen = visibility(p, light); // by all lanes
                reaching[p] = pair_lit ? falloff(rays[p]) * seen : 0.0;
                lits[p] = lit_by(surfaces[p], rays[p].l, nl);
                vec3 glossy = lits[p].specular * fresnel_of(gradients[p], lits[p].fresnel) * gradients[p].gradient;
                weight[p] = reaching[p] * nl * (gradients[p].matte + glossy);
                emitted[p] = turn[p] = vec3(0.0);
            }
            [[dont_unroll]] for (uint g = 0u; g < GROUPS; g++) {
                float values[SUBGROUP];
                [[unroll]] for (uint j = 0u; j < GROUP; j++) {
                    uint k = g * GROUP + j;
                    vec3 axis = vec3(0.0), amplitude = vec3(0.0);
                    float sharpness = 0.0;
                    if (k < LOBES) {
                        Lobe lobe = load_lobe(light, k);
                        EACH_PIXEL(p) {
                            vec3 u = lobe.axis.w * rays[p].l - lobe.axis.xyz;
                            float square = dot(u, u);
                            float s = exp2(-square);
                            emitted[p] += s * lobe.amplitude;
                            vec3 ws = s * weight[p];
                            float t = dot(ws, lobe.amplitude);
                            vec3 tu = t * u;
                            turn[p] -= lobe.axis.w * tu;
                            axis += tu;
                            sharpness += t * square;
                            amplitude += ws;
                        }
                    }
                    values[8u * j] = axis.x;
                    values[8u * j + 1u] = axis.y;
                    values[8u * j + 2u] = axis.z;
                    values[8u * j + 3u] = sharpness;
                    values[8u * j + 4u] = amplitude.r;
                    values[8u * j + 5u] = amplitude.g;
                    values[8u * j + 6u] = amplitude.b;
                    values[8u * j + 7u] = 0.0;
                }
                LANE_SUMS(values)
                keep(light, 8u + g * SUBGROUP, 8u * LOBES - g * SUBGROUP, values[0]);
            }
            vec3 sum = vec3(0.0);
            EACH_PIXEL(p) {
                sum += position_gradient_of(surfaces[p], rays[p], lits[p], gradients[p], reaching[p] * emitted[p],
                                            NATURAL * turn[p]);
            }
            sum = vec3(subgroupAdd(sum.x), subgroupAdd(sum.y), subgroupAdd(sum.z));
            uint lane = gl_SubgroupInvocationID & 7u;
            keep(light, 0u, 8u, lane == 0u ? sum.x : lane == 1u ? sum.y : lane == 2u ? sum.z : 0.0);
        }
    }
    write_row();
}
