// Computes the class of every pixel of an image, and its relevance to one query class.
#version 460
#include "common.glsl"
#include "step.glsl"
#include "semantic.glsl"

layout(constant_id = 0) const uint SUBGROUP = 32;
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint TILES = 1;
layout(constant_id = 3) const uint CLASSES = 1;
layout(constant_id = 4) const uint CHANNELS = 35;
layout(constant_id = 5) const uint FIRST = 3;
layout(constant_id = 6) const bool COSINE = false; // relevance is the cosine, else the probability of the softmax

layout(push_constant, scalar) uniform Push { uint query; } push; // query class

layout(scalar) uniform StepBlock { Step step; } params;

IN(float, image);
IN(float, matrices);
OUT(uint, labels);     // NO_LABEL where a feature is not finite
OUT(float, relevance); // 0 where a feature is not finite

#include "semantic_batch.glsl"
#include "fetch_items.glsl"

void main() {
    uvec2 size = params.step.camera.size;
    uint pixels = size.x * size.y;
    keep_rows();
    uint stride = gl_NumWorkGroups.x * gl_NumWorkGroups.y * BATCH;
    for (uint from = folded_workgroup() * BATCH; from < pixels; from += stride) {
        EACH_TILE(t) live[t] = true;
        FETCH_ITEMS(min(from + t * SUBGROUP + lane_of(n), pixels - 1u))
        bring();
        measure();
        float best[TILES], query_score[TILES];
        uint label[TILES];
        Softmax s[TILES];
        EACH_TILE(t) {
            best[t] = -1e38;
            query_score[t] = 0.0;
            label[t] = 0u;
            s[t] = Softmax(-1e30, 0.0);
        }
        for (uint c = 0u; c < CLASSES; c++) {
            fetch_row(AUGMENTED + c);
            EACH_TILE(t) {
                float sum = product(t);
                label[t] = sum > best[t] ? c : label[t];
                best[t] = max(best[t], sum);
                query_score[t] = c == push.query ? sum * inverse[t] : query_score[t];
                if (!COSINE) add_logit(s[t], sum * inverse[t] * params.step.inverse_temperature);
            }
        }
        EACH_TILE(t) {
            uint pixel = from + t * SUBGROUP + gl_SubgroupInvocationID;
            float logit = query_score[t] * params.step.inverse_temperature;
            if (pixel < pixels) {
                labels[pixel] = live[t] ? label[t] : NO_LABEL;
                relevance[pixel] = !live[t] ? 0.0 : COSINE ? query_score[t] : exp(logit - s[t].top) / s[t].total;
            }
        }
    }
}
