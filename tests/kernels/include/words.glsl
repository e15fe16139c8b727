// Shared definitions of the kernels of random graphs: words in, words out, and the hash of the CPU reference.
#extension GL_EXT_scalar_block_layout : require

layout(local_size_x = 32) in;

layout(push_constant, scalar) uniform Push { uint seed; } push;

#define IN(name) layout(scalar) readonly buffer name##_block { uint name[]; }
#define OUT(name) layout(scalar) writeonly buffer name##_block { uint name[]; }
#define INOUT(name) layout(scalar) buffer name##_block { uint name[]; }

uint mixed(uint a, uint b) {
    uint x = a ^ (b * 0x9e3779b9u);
    x ^= x >> 15;
    x *= 0x85ebca6bu;
    x ^= x >> 13;
    return x;
}

// Every invocation takes each so many-th word.
#define EACH(i, count) \
    for (uint i = gl_GlobalInvocationID.x; i < count; i += 32u * gl_NumWorkGroups.x)
