// Iteration of a linear system x = source + reflectance * (M x), where M is the transport matrix or its transpose. The
// including kernel defines `vec3 transport_gather(uint receiver, uint light, uint lane)`: the share of a lane in row
// `receiver` of M x, before the division by the number of rays.
//
// LANES invocations share a receiver; lights are the second index of workgroups. Chebyshev's semi-iterative method;
// with weights of 1, Jacobi's. A light whose last iteration changed no value by more than the tolerance is left alone; so are
// its later iterations, whose changes stay zero.

layout(push_constant, scalar) uniform Push {
    uint receivers;
    uint lights;
    uint rows; // of an image of a light
    uint iteration;
    float weight;    // of a ray
    float tolerance; // largest relative change
    float least;     // share of the largest first value; changes of smaller values are relative to it
} push;

IN(float, relaxation); // weights of the iterations
INOUT(uint, progress); // [lights]: largest first value; [iterations + 1][lights]: largest relative change; bits of floats
layout(rgba32f) uniform restrict readonly image2D source;
layout(rgba32f) uniform restrict readonly image2D reflectance; // of one light's size
layout(rgba32f) uniform restrict readonly image2D current;
layout(rgba32f) uniform restrict image2D next; // holds the values before the current ones
layout(rgba32f) uniform restrict writeonly image2D gathered;

vec3 transport_gather(uint receiver, uint light, uint lane);

void main() {
    uint light = gl_WorkGroupID.y, slot = (push.iteration + 1u) * push.lights + light;
    float level = push.least * uintBitsToFloat(progress[light]);
    if (!(uintBitsToFloat(progress[slot]) > push.tolerance)) return;

    uint lane = gl_SubgroupInvocationID % LANES, mine = gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID;
    uint receiver = gl_WorkGroupID.x * (WORKGROUP / LANES) + mine / LANES;
    bool real = receiver < push.receivers;
    receiver = min(receiver, push.receivers - 1u);
    vec3 sum = push.weight * transport_gather(receiver, light, lane);
    [[unroll]] for (uint other = LANES / 2u; other > 0u; other /= 2u) {
        uint from = gl_SubgroupInvocationID ^ other;
        sum += vec3(subgroupShuffle(sum.x, from), subgroupShuffle(sum.y, from), subgroupShuffle(sum.z, from));
    }
    float change = 0.0;
    if (real && lane == 0u) {
        ivec2 at = transport_texel(receiver, light, push.rows);
        vec3 reflected = imageLoad(reflectance, transport_texel(receiver, 0u, push.rows)).xyz * sum;
        vec3 value = imageLoad(source, at).xyz + reflected;
        vec3 moved = abs(value - imageLoad(current, at).xyz) / max(abs(value), max(level, 1e-30));
        change = max(max(moved.x, moved.y), moved.z);
        vec3 before = imageLoad(next, at).xyz;
        imageStore(gathered, at, vec4(sum, 0.0));
        imageStore(next, at, vec4(before + relaxation[push.iteration] * (value - before), 0.0));
    }
    change = subgroupMax(change);
    // An iteration that ran is not zero.
    if (subgroupElect()) atomicMax(progress[slot + push.lights], max(floatBitsToUint(change), 1u));
}
