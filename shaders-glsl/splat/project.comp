// Projects the Gaussians that `project_count` marked as visible into a compact list: footprint, depth, channels, number
// of tiles. Culled Gaussians are not read.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "distortion.glsl"
#include "work.glsl"
#include "splat.glsl"
#include "projection.glsl"
#include "gaussian.glsl"
#include "sh.glsl"

layout(constant_id = 0) const uint WORKGROUP = 256;  // a multiple of 32
layout(constant_id = 1) const uint SUBGROUP = 32;
layout(constant_id = 2) const uint SH_DEGREE = 3;    // stored bands
layout(constant_id = 3) const uint CHANNELS = 3;     // rgb, normal, z and z², each if any
layout(constant_id = 4) const bool HAS_NORMALS = false;
layout(constant_id = 5) const bool HAS_DEPTH = false;
layout(constant_id = 6) const uint TILE_WIDTH = 16;
layout(constant_id = 7) const uint TILE_HEIGHT = 16;
layout(constant_id = 8) const bool HAS_COLORS = true;
layout(constant_id = 9) const uint DEPTH_BITS = 31;  // of the keys that splats are sorted by
layout(local_size_x_id = 0) in;
#include "channels.glsl"
#include "large_splats.glsl"
#include "large_tiles.glsl"

layout(scalar) uniform StepBlock { Step step; } params;
IN(Work, gaussians);
IN(uvec4, parameters);
IN(uint, visible_bits);
IN(uint, block_offsets);
OUT(uint, splat_ids);
OUT(uint, depth_keys);
OUT(Splat, splats);
OUT(uint, features);
OUT(uint, tile_counts);

#include "parameter_columns.glsl"

const uint NO_SLOT = 0xffffffffu;

// Columns of bands above the active degree are not read.
vec3 color_of(uint i, vec3 mean) {
    Camera camera = params.step.camera;
    uint degree = min(SH_DEGREE, by_workgroup(params.step.sh_degree));
    vec3 away = mean - camera.position;
    vec3 d = away * inversesqrt(max(dot(away, away), 1e-30));
    float basis[16];
    sh_basis(d, degree, basis);
    vec3 color = vec3(0.0);
    uvec4 pair = uvec4(0u);
    [[unroll]] for (uint c = 0u; c < harmonic_columns(SH_DEGREE); ++c) {
        if (4u * c >= harmonic_numbers(degree)) continue;
        vec4 values = harmonic_column(pair, i, c);
        [[unroll]] for (uint j = 0u; j < 4u; ++j) {
            uint number = 4u * c + j;
            if (number < harmonic_numbers(SH_DEGREE)) color[number % 3u] += basis[number / 3u] * values[j];
        }
    }
    color += 0.5;
    // A splat with colors that are not finite shows black rather than poisoning every pixel it touches.
    return vec3(color.x > 0.0 ? min(color.x, 1e6) : 0.0, color.y > 0.0 ? min(color.y, 1e6) : 0.0,
                color.z > 0.0 ? min(color.z, 1e6) : 0.0);
}

// Positive numbers sort as their bits do. Shorter keys count in equal parts of a power of two from the near plane on, 32
// powers in all; splats of one key stay in the order of their numbers.
uint depth_key(float z, float near) {
    uint bits = floatBitsToUint(z);
    if (DEPTH_BITS >= 31u) return bits;
    uint above = bits - floatBitsToUint(max(near, 1e-30));
    return min(above >> (28u - DEPTH_BITS), (1u << DEPTH_BITS) - 1u);
}

uint count_own_tiles(Splat s, float limit, PixelBox box) {
    int width = int(TILE_WIDTH), height = int(TILE_HEIGHT);
    uint count = 0u;
    for (int ty = box.low.y / height; ty <= box.high.y / height; ++ty) {
        ivec2 span = splat_tile_span(s, limit, box, ty * height, ty * height + height - 1, width);
        if (span.x > span.y) continue;
        count += span.x == span.y ? 1u : 2u;
        for (int tx = span.x + 1; tx < span.y; ++tx) {
            count += uint(splat_touches(s, limit, tx * width, tx * width + width - 1, max(ty * height, box.low.y),
                                        min(ty * height + height - 1, box.high.y)));
        }
    }
    return count;
}

// Tiles of each lane's footprint: a lane counts those of a small one, all lanes together those of a large one.
uint count_tiles(Footprint own) {
    bool large = is_large(own);
    uint count = large ? 0u : count_own_tiles(own.splat, own.limit, own.box);
    uvec4 votes = subgroupBallot(large);
    while (any(notEqual(votes, uvec4(0u)))) {
        uint lane = next_large(votes);
        Footprint f = footprint_of_lane(own, lane);
        uint found = 0u;
        WALK_TILES(f, found += subgroupBallotBitCount(subgroupBallot(touched));)
        if (lane == gl_SubgroupInvocationID) count = found;
    }
    return min(count, (1u << 19) - 1u);
}

// Writes everything but the number of tiles of this lane's splat. Returns its slot, or NO_SLOT if there is none.
uint project_own(out Footprint footprint) {
    footprint = Footprint(Splat(vec2(0.0), vec3(1.0, 0.0, 1.0), 0.0), 0.0, EMPTY_BOX);
    uint block = folded_workgroup();
    uint i = block * WORKGROUP + gl_LocalInvocationID.x;
    if (i >= gaussians[0].count) return NO_SLOT;
    uint word = i / 32u, bit = 1u << (i % 32u), bits = visible_bits[word];
    if ((bits & bit) == 0u) return NO_SLOT;
    uint v = block_offsets[block] + bitCount(bits & (bit - 1u));
    for (uint w = block * (WORKGROUP / 32u); w < word; ++w) v += bitCount(visible_bits[w]);
    Camera camera = params.step.camera;
    vec4 place = parameter_column(i, 0u), size = parameter_column(i, 1u), rotation = parameter_column(i, 2u);
    Projection p;
    bool projects = project_splat(camera, place.xyz, size.xyz, rotation, place.w, p);
    if (!projects) {
        // Its slot is taken: a footprint that touches no tile.
        p.point = vec3(0.0, 0.0, camera.near);
        p.splat = Splat(vec2(0.0), vec3(1.0, 0.0, 1.0), 0.0);
    }
    float limit = exponent_limit(p.splat);
    PixelBox box = splat_box(p.splat, limit, camera.size);
    projects = projects && !box_is_empty(box);
    splat_ids[v] = i;
    depth_keys[v] = depth_key(p.point.z, camera.near);
    splats[v] = p.splat;
    footprint = Footprint(p.splat, limit, projects ? box : EMPTY_BOX);
    uint at = v * CHANNEL_WORDS;
    if (HAS_COLORS) {
        vec3 color = color_of(i, place.xyz);
        if (COLOR_BITS == 16u) {
            features[at] = pack_halves(color.xy);
            features[at + 1u] = pack_halves(vec2(color.z, 0.0));
            at += 2u;
        } else {
            features[at] = floatBitsToUint(color.x);
            features[at + 1u] = floatBitsToUint(color.y);
            features[at + 2u] = floatBitsToUint(color.z);
            at += 3u;
        }
    }
    if (HAS_NORMALS) {
        vec3 n = parameter_column(i, COLUMNS - 1u).xyz;
        n /= max(length(n), 1e-3);
        features[at] = floatBitsToUint(n.x);
        features[at + 1u] = floatBitsToUint(n.y);
        features[at + 2u] = floatBitsToUint(n.z);
        at += 3u;
    }
    if (HAS_DEPTH) {
        float z = min(p.point.z, DEPTH_MAX);
        features[at] = floatBitsToUint(z);
        features[at + 1u] = floatBitsToUint(z * z);
    }
    return v;
}

void main() {
    Footprint footprint;
    uint v = project_own(footprint);
    uint count = count_tiles(footprint);
    if (v != NO_SLOT) tile_counts[v] = count;
}
