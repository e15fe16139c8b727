// Marks the pixels of a pseudo-view that show the region of a training view, as a bit mask.
//
// Each pixel is unprojected by its depth and reprojected into the training view. The pixel belongs to the region if it
// lands on a pixel of the region with the same depth. The kernel gathers, so results do not depend on the order of
// invocations.
#version 460
#include "common.glsl"
#include "finite.glsl"
#include "step.glsl"
#include "distortion.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256; // a multiple of 32
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint CHANNELS = 8;         // floats of a pixel of the pseudo-view's image
layout(constant_id = 3) const uint DEPTH_AT = 6;         // channel of depth
layout(constant_id = 4) const uint TRAINED_CHANNELS = 8; // the same for the training view's image
layout(constant_id = 5) const uint TRAINED_DEPTH_AT = 6;

layout(push_constant, scalar) uniform Push {
    float least_opacity; // pixels of lower opacity have no depth
    float tolerance;     // relative tolerance of depths
} push;

layout(scalar) uniform StepBlock { Step step; } params;     // of the pseudo-view
layout(scalar) uniform TrainedBlock { Step step; } trained; // of the training view

IN(float, image);
IN(float, transmittance);
IN(float, trained_image);
IN(float, trained_transmittance);
IN(uint, trained_mask); // one bit per pixel, from word `mask_offset` of the training view's step
OUT(uint, mask);        // one bit per pixel

const uint WORDS = WORKGROUP / 32u;
const float DEPTH_MIN = 1e-15; // range of valid depths, in which products neither overflow nor underflow
const float DEPTH_MAX = 1e15;

shared uint words[WORDS];

// Returns the depth from the blended depth; 0 if the pixel has none.
float depth_of(float blended, float left) {
    float opacity = 1.0 - left;
    bool there = finite_bits(blended) && finite_bits(left) && opacity >= max(push.least_opacity, 1e-6);
    float depth = there ? blended / opacity : 0.0;
    return finite_bits(depth) && depth >= DEPTH_MIN && depth <= DEPTH_MAX ? depth : 0.0;
}

bool carried(uint pixel) {
    Camera from = params.step.camera, to = trained.step.camera;
    if (pixel >= from.size.x * from.size.y) return false;
    float depth = depth_of(image[pixel * CHANNELS + DEPTH_AT], transmittance[pixel]);
    if (depth == 0.0) return false;
    vec2 center = vec2(pixel % from.size.x, pixel / from.size.x) + 0.5;
    vec3 seen = vec3(pixel_slope(from, center) * depth, depth);
    vec4 r0 = from.world_to_camera[0], r1 = from.world_to_camera[1], r2 = from.world_to_camera[2];
    seen -= vec3(r0.w, r1.w, r2.w);
    vec4 world = vec4(r0.xyz * seen.x + r1.xyz * seen.y + r2.xyz * seen.z, 1.0);
    vec3 p = vec3(dot(to.world_to_camera[0], world), dot(to.world_to_camera[1], world),
                  dot(to.world_to_camera[2], world));
    if (!finite_bits(p.z) || !(p.z >= max(to.near, DEPTH_MIN))) return false;
    vec2 offset = to.focal * p.xy / p.z;
    if (DISTORTED) offset *= distortion_terms(to, offset).x;
    vec2 at = offset + to.center;
    if (!finite_bits(at.x) || !finite_bits(at.y)) return false;
    if (!(all(greaterThanEqual(at, vec2(0.0))) && all(lessThan(at, vec2(to.size))))) return false;
    uint there = uint(at.y) * to.size.x + uint(at.x);
    if ((trained_mask[trained.step.mask_offset + there / 32u] >> there % 32u & 1u) == 0u) return false;
    float other = depth_of(trained_image[there * TRAINED_CHANNELS + TRAINED_DEPTH_AT], trained_transmittance[there]);
    return other > 0.0 && abs(p.z - other) <= push.tolerance * other;
}

void main() {
    uint lane = gl_LocalInvocationID.x, first = folded_workgroup() * WORKGROUP;
    if (lane < WORDS) words[lane] = 0u;
    barrier();
    // Words have 32 pixels, whatever the subgroup size.
    if (carried(first + lane)) atomicOr(words[lane / 32u], 1u << lane % 32u);
    barrier();
    uint word = first / 32u + lane;
    if (lane < WORDS && word < mask.length()) mask[word] = words[lane];
}
