// Shared definitions of kernels that shade pixels under prepared lights.
//
// A subgroup takes PER_LANE times SUBGROUP pixels. Its lanes fetch positions of lights, and all visit together each light
// that one of their pixels faces. Include common.glsl and step.glsl before.
//
// A kernel that includes this and one of the bodies (lights_forward.glsl, lights_bwd.glsl, ...) defines visibility in
// between, as three functions:
//     void visibility_begin(uint slot, uint pixel)   before the first light, for each of the lane's PER_LANE pixels
//     bool next_light(inout Walk way, out uint light, out vec3 place)   walk() below, or the same for lights ahead
//     float visibility(uint slot, uint light)        0 to 1, for the pixel that visibility_begin named last for this slot,
//                                                  and the light that next_light found last
// Slots are constants after unrolling, so arrays by slot stay in registers. points[pixel] is the place of a pixel and
// prepared[light_at(light)].xyz that of a light. Every lane of a subgroup calls them together; where pair_lit is false the
// result does not matter, and `pixel` may be any pixel of the view.

layout(constant_id = 0) const uint SUBGROUP = 32; // lanes, and invocations of a workgroup
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint LOBES = 12;
layout(constant_id = 2) const bool METALLIC = false; // without it metallic is 0 everywhere
layout(constant_id = 3) const uint PER_LANE = 1;     // pixels of a lane
layout(constant_id = 4) const bool SPREAD = false;   // lanes fetch a number of a lobe each, for devices that load lane by lane

#include "brdf.glsl"
#include "coverage.glsl"
#include "lights.glsl"

layout(scalar) uniform StepBlock { Step step; } params;

IN(vec4, prepared);         // lights, see lights.glsl
IN(float, prepared_floats); // the same
IN(uint, light_list);       // how many are on, and which
IN(vec3, points);           // world
IN(vec3, normals);          // unit or zero
IN(float, coverage);        // blended opacity
IN(vec4, materials);        // linear albedo, roughness
IN(float, metallic);

#define EACH_PIXEL(p) [[unroll]] for (uint p = 0u; p < PER_LANE; p++)

Surface surfaces[PER_LANE];
bool pair_lit;

uint pixel_count() { return params.step.camera.size.x * params.step.camera.size.y; }

// A lane's pixel in a block; those of neighboring lanes are neighbors.
uint pixel_of(uint block, uint p) { return (block * PER_LANE + p) * SUBGROUP + gl_SubgroupInvocationID; }

// Whether a pixel exists and has a surface.
bool shaded(uint pixel, uint count) {
    bool inside = pixel < count;
    float c = coverage[min(pixel, count - 1u)];
    return inside && is_covered(c);
}

// The surface of a pixel; one without a normal, which cannot face anything, where there is none.
Surface load_surface(uint pixel, bool is_shaded) {
    vec3 camera = params.step.camera.position;
    Surface s = surface(camera + vec3(0.0, 0.0, 1.0), vec3(0.0), 1.0, camera);
    if (is_shaded) s = surface(points[pixel], normals[pixel], materials[pixel].w, camera);
    return s;
}

Lobe load_lobe(uint light, uint k) {
    uint at = light_at(light) + 1u + 2u * k;
    Lobe r;
    if (SPREAD) {
        float mine = prepared_floats[4u * at + (gl_SubgroupInvocationID & 7u)];
        r.axis.x = subgroupBroadcast(mine, 0u);
        r.axis.y = subgroupBroadcast(mine, 1u);
        r.axis.z = subgroupBroadcast(mine, 2u);
        r.axis.w = subgroupBroadcast(mine, 3u);
        r.amplitude.r = subgroupBroadcast(mine, 4u);
        r.amplitude.g = subgroupBroadcast(mine, 5u);
        r.amplitude.b = subgroupBroadcast(mine, 6u);
    } else {
        r.axis = prepared[at];
        r.amplitude = prepared[at + 1u].rgb;
    }
    return r;
}

// The way through the list of lights.
struct Walk {
    uint count;   // lights that are on
    uint first;   // of the batch whose lights the lanes hold
    uint next;    // in the batch
    uint light;   // a lane's
    vec3 place;   // of a lane's light
    uvec4 bright; // which lanes' lights can matter here
    vec3 low, high; // a box around the subgroup's points
};

// A light is left out of a subgroup's pixels if all of them are farther away than it reaches.
void fetch_batch(inout Walk w) {
    uint i = w.first + gl_SubgroupInvocationID;
    w.light = light_list[1u + min(i, w.count - 1u)];
    vec4 place = prepared[light_at(w.light)];
    w.place = place.xyz;
    vec3 apart = max(max(w.low - place.xyz, place.xyz - w.high), vec3(0.0));
    w.bright = subgroupBallot(i < w.count && max(dot(apart, apart), NEAR_SQUARED) <= place.w);
}

Walk begin_walk() {
    vec3 low = vec3(1e18), high = vec3(-1e18);
    EACH_PIXEL(p) {
        // Without a normal nothing is lit.
        if (surfaces[p].normal != vec3(0.0)) {
            low = min(low, surfaces[p].point);
            high = max(high, surfaces[p].point);
        }
    }
    low = vec3(subgroupMin(low.x), subgroupMin(low.y), subgroupMin(low.z));
    high = vec3(subgroupMax(high.x), subgroupMax(high.y), subgroupMax(high.z));
    Walk w = Walk(light_list[0], 0u, 0u, 0u, vec3(0.0), uvec4(0u), low, high);
    if (w.count > 0u) fetch_batch(w);
    return w;
}

// Goes to the next light that a pixel of the subgroup faces; false if there is none. All are loops because those are the
// only branches that software devices take.
bool walk(inout Walk w, out uint light, out vec3 place) {
    for (; w.first + w.next < w.count;) {
        for (; w.next < SUBGROUP && !subgroupBallotBitExtract(w.bright, w.next); w.next++) {}
        uint lane = min(w.next, SUBGROUP - 1u);
        light = subgroupShuffle(w.light, lane);
        place = vec3(subgroupShuffle(w.place.x, lane), subgroupShuffle(w.place.y, lane), subgroupShuffle(w.place.z, lane));
        bool faced = false;
        EACH_PIXEL(p) faced = faced || dot(surfaces[p].normal, place - surfaces[p].point) > 0.0;
        bool found = w.next < SUBGROUP && subgroupAny(faced);
        w.next++;
        if (w.next >= SUBGROUP) {
            w.first += SUBGROUP;
            w.next = 0u;
            if (w.first < w.count) fetch_batch(w);
        }
        if (found) return true;
    }
    return false;
}
