// First values of an iteration, their largest, and images of what all iterations read. An invocation for each receiver, one
// for the texel after them; lights are the second index of workgroups. The including kernel defines `vec3
// transport_initial(uint receiver, uint light, out vec3 lit)`, which also gives the source.

layout(push_constant, scalar) uniform Push {
    uint receivers;
    uint lights;
    uint rows; // of an image of a light
} push;

IN(vec3, reflectance_values); // [receivers]
INOUT(uint, progress);        // see transport_step.glsl; cleared
layout(rgba32f) uniform restrict writeonly image2D first;
layout(rgba32f) uniform restrict writeonly image2D second;
layout(rgba32f) uniform restrict writeonly image2D source;
layout(rgba32f) uniform restrict writeonly image2D reflectance;

vec3 transport_initial(uint receiver, uint light, out vec3 lit);

void main() {
    uint light = gl_WorkGroupID.y, receiver = gl_WorkGroupID.x * WORKGROUP + gl_LocalInvocationID.x;
    vec3 value = vec3(0.0), lit = vec3(0.0);
    if (receiver < push.receivers) {
        value = transport_initial(receiver, light, lit);
        imageStore(source, transport_texel(receiver, light, push.rows), vec4(lit, 0.0));
        if (light == 0u) {
            imageStore(reflectance, transport_texel(receiver, 0u, push.rows), vec4(reflectance_values[receiver], 0.0));
        }
    }
    if (receiver <= push.receivers) {
        ivec2 at = transport_texel(receiver, light, push.rows);
        imageStore(first, at, vec4(value, 0.0));
        imageStore(second, at, vec4(value, 0.0));
    }
    value = max(abs(value), abs(lit));
    float top = subgroupMax(max(max(value.x, value.y), value.z));
    if (subgroupElect()) {
        atomicMax(progress[light], floatBitsToUint(top));
        // Before the first iteration, all values are yet to change.
        atomicMax(progress[push.lights + light], 0x7f7fffffu);
    }
}
