// Displays an image in a window: gain, encoding, overlaid marks and letters, packed in the window's format.
#version 460
#include "common.glsl"
#include "finite.glsl"
#include "srgb.glsl"

layout(constant_id = 0) const uint TEXEL = 0; // 0 RGBA8, 1 BGRA8
layout(constant_id = 1) const uint CELL_WIDTH = 8;
layout(constant_id = 2) const uint CELL_HEIGHT = 16;
layout(constant_id = 3) const uint FIRST_LETTER = 32;
layout(constant_id = 4) const uint LETTERS = 96;
layout(local_size_x = 8, local_size_y = 8) in;

layout(push_constant, scalar) uniform Push { uvec2 size; uvec2 image_size; } push;

struct ShowStep {
    uint kind;        // the image holds: 0 encoded color, 1 linear light, 2 values, 3 directions
    float gain;       // of light, of values
    uint marks;       // how many there are
    uint columns;     // letters in a line
    uint rows;        // lines
    uint letter_size; // pixels of the screen along a pixel of a letter
};

struct Mark {
    vec2 at;       // pixels
    float radius;  // pixels
    uint style;     // 1: ringed, white within dark; 2: hollow
    vec3 color;    // encoded
};

layout(scalar) uniform StepBlock { ShowStep step; } params;
layout(rgba16f) uniform restrict readonly image2D image;
IN(Mark, marks);
IN(uint, text);  // a byte a cell, line by line; 0 leaves the image as it is
IN(uint, font);  // a byte a pixel, letter by letter
OUT(uint, texels);

vec3 texel(ivec2 at) {
    return only_finite(imageLoad(image, clamp(at, ivec2(0), ivec2(push.image_size) - 1)).xyz);
}

// The image at a pixel of the window; an image of another size is interpolated bilinearly.
vec3 image_at(uvec2 at) {
    if (push.image_size == push.size) return texel(ivec2(at));
    vec2 place = (vec2(at) + 0.5) * vec2(push.image_size) / vec2(push.size) - 0.5;
    ivec2 low = ivec2(floor(place));
    vec2 t = place - vec2(low);
    vec3 above = mix(texel(low), texel(low + ivec2(1, 0)), t.x);
    vec3 below = mix(texel(low + ivec2(0, 1)), texel(low + ivec2(1, 1)), t.x);
    return mix(above, below, t.y);
}

uint byte_of(float v) { return uint(clamp(v, 0.0, 1.0) * 255.0 + 0.5); }

void main() {
    uvec2 at = gl_GlobalInvocationID.xy;
    if (any(greaterThanEqual(at, push.size))) return;
    uint kind = by_workgroup(params.step.kind);
    float gain = params.step.gain;
    vec3 v = image_at(at);
    // Decoding and encoding again would change bits.
    if (kind == 0u) {
        v = gain == 1.0 ? v : srgb_encode(srgb_decode(v) * gain);
    } else if (kind == 1u) {
        v = srgb_encode(v * gain);
    } else {
        v = kind == 2u ? v * gain : v * 0.5 + 0.5;
    }
    v = clamp(v, 0.0, 1.0);

    vec2 center = vec2(at) + 0.5;
    uint count = by_workgroup(params.step.marks);
    for (uint i = 0u; i < count; i++) {
        Mark mark = marks[i];
        float away = distance(center, mark.at) - mark.radius;
        if (away > 5.0) continue;
        // A pixel wide, edges run from all to nothing.
        float disc = clamp(0.5 - away, 0.0, 1.0);
        float rim = disc - clamp(-1.0 - away, 0.0, 1.0);
        float inside = (mark.style & 2u) != 0u ? disc - clamp(-2.5 - away, 0.0, 1.0) : disc;
        v = mix(v, mark.color, inside);
        v = mix(v, vec3(0.05), rim);
        if ((mark.style & 1u) != 0u) {
            // A dark line around the light one, visible on white.
            float ring = clamp(3.5 - away, 0.0, 1.0) - clamp(1.5 - away, 0.0, 1.0);
            float around = clamp(4.5 - away, 0.0, 1.0) - clamp(3.5 - away, 0.0, 1.0);
            v = mix(mix(v, vec3(0.05), around), vec3(1.0), ring);
        }
    }

    uvec2 cell = uvec2(CELL_WIDTH, CELL_HEIGHT) * max(params.step.letter_size, 1u);
    uvec2 place = at / cell;
    if (place.x < by_workgroup(params.step.columns) && place.y < by_workgroup(params.step.rows)) {
        uint k = place.y * params.step.columns + place.x;
        uint letter = (text[k / 4u] >> (8u * (k % 4u))) & 0xffu;
        if (letter >= FIRST_LETTER && letter < FIRST_LETTER + LETTERS) {
            uvec2 dot = (at % cell) / max(params.step.letter_size, 1u);
            uint p = ((letter - FIRST_LETTER) * CELL_HEIGHT + dot.y) * CELL_WIDTH + dot.x;
            float ink = float((font[p / 4u] >> (8u * (p % 4u))) & 0xffu) / 255.0;
            v = mix(0.35 * v, vec3(0.95), ink);
        }
    }
    uint r = byte_of(TEXEL == 1u ? v.z : v.x);
    uint b = byte_of(TEXEL == 1u ? v.x : v.z);
    texels[at.y * push.size.x + at.x] = r | byte_of(v.y) << 8 | b << 16 | 0xff000000u;
}
